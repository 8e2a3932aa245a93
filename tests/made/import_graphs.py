"""Import graphs of Python packages and Rust crates, and their cycles.

A graph maps the dotted name of each module to the imported modules of the same tree. `__init__.py` and
`mod.rs` have the name of their folder; `lib.rs` is `crate`.
"""

import ast
import re
from collections.abc import Collection, Iterable, Iterator
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path

Graph = dict[str, set[str]]


def build_python_graph(root: Path, packages: Iterable[str], *, inside: str = "") -> Graph:
    """Build the graph of imports between the modules of some packages.

    Imports inside functions and for type checking count, too. A stub represents a compiled module. A string
    that equals the name of a module counts as an import, because lazy imports name their modules by strings.
    With `inside`, the packages are subpackages of that package, wherever their folders are.
    """
    files = [path for package in packages for path in (root / package).rglob("*.py*")]
    sources = [path for path in files if path.suffix in (".py", ".pyi")]
    modules = {to_module_name(inside / path.relative_to(root)): path for path in sources}
    return {
        name: set(find_python_imports(ast.parse(path.read_text(encoding="utf-8")), modules)) - {name}
        for name, path in modules.items()
    }


def find_python_imports(tree: ast.Module, modules: Collection[str]) -> Iterator[str]:
    """Find the modules in `modules` that a syntax tree imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (owner for alias in node.names if (owner := find_owner(alias.name, modules)))
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (owner for name in names if (owner := find_owner(name, modules)))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "." in node.value:
            yield from {node.value} & set(modules)


def build_rust_graph(source: Path) -> Graph:
    """Build the graph of imports between the files of a crate: `use`, paths in the code, and `mod`.

    Imports of unit tests are ignored: tests may use every module.
    """
    paths = {to_module_name("crate" / path.relative_to(source)): path for path in source.rglob("*.rs")}
    texts = {name: path.read_text(encoding="utf-8") for name, path in paths.items() if path.stem != "tests"}
    return {
        name: {owner for path in find_rust_paths(name, text) if (owner := find_owner(path, texts))} - {name}
        for name, text in texts.items()
    }


def find_rust_paths(name: str, text: str) -> Iterator[str]:
    """Find every path within the crate that a file uses, absolute from the crate's root."""
    code = re.sub(r"//.*", "", text)
    code = re.sub(r"#\[cfg\(test\)\]\s*mod \w+(?:;| \{.*)", "", code, flags=re.DOTALL)
    children = re.findall(r"\bmod (\w+);", code)
    trees = re.findall(r"\buse ([^;]+);", code)
    trees += re.findall(r"(?<![\w:])(?:crate|super|self)(?:::\w+)+", re.sub(r"\buse [^;]+;", "", code))
    paths = [[child] for child in children] + [path for tree in trees for path in expand_use_tree(tree)]
    for first, *rest in paths:
        if first in children:
            yield f"{name}.{'.'.join([first, *rest])}"
        elif first in ("crate", "self", "super"):
            at = {"crate": "crate", "self": name, "super": get_parent(name)}[first]
            while rest[:1] == ["super"]:
                at, rest = get_parent(at), rest[1:]
            yield ".".join([at, *rest])


def expand_use_tree(tree: str) -> list[list[str]]:
    """Expand a tree of `use`: `a::{b, c::{d, e}}` becomes a::b, a::c::d and a::c::e."""
    head, brace, group = tree.partition("{")
    steps = re.findall(r"\w+", head.split(" as ")[0])
    if not brace:
        return [steps] if steps else []
    branches, depth = [""], 0
    for letter in group[: group.rindex("}")]:
        depth += (letter == "{") - (letter == "}")
        if letter == "," and depth == 0:
            branches.append("")
        else:
            branches[-1] += letter
    return [steps + path for branch in branches for path in expand_use_tree(branch)]


def to_module_name(path: Path) -> str:
    """Convert the path of a file in its tree to the name of its module."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] in ("__init__", "mod", "lib") else parts)


def get_parent(name: str) -> str:
    """Get the name of the package that contains a module."""
    return name.rpartition(".")[0]


def find_owner(name: str, modules: Collection[str]) -> str | None:
    """Find the longest prefix of a dotted name that is one of `modules`."""
    while name and name not in modules:
        name = get_parent(name)
    return name or None


def is_in_folder(module: str, folder: str) -> bool:
    return not folder or module == folder or module.startswith(f"{folder}.")


def build_folder_graph(graph: Graph, folder: str) -> Graph:
    """Build the graph of imports between the entries of a folder: its files and its subfolders."""
    depth = folder.count(".") + 2 if folder else 1

    def get_entry(module: str) -> str:
        return ".".join(module.split(".")[:depth])

    entry_graph: Graph = {}
    for module, imported in graph.items():
        if module != folder and is_in_folder(module, folder):
            others = {get_entry(to) for to in imported if to != folder and is_in_folder(to, folder)}
            entry_graph.setdefault(get_entry(module), set()).update(others - {get_entry(module)})
    return entry_graph


def find_cycle(graph: Graph) -> list[str] | None:
    """Find a cycle of imports, the same one in every run."""
    imports = {module: sorted(graph[module]) for module in sorted(graph)}
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        ring = error.args[1][:0:-1]
        first = ring.index(min(ring))
        return [*ring[first:], *ring[: first + 1]]
    return None


def find_cycles(graph: Graph) -> list[str]:
    """Describe a cycle of files, and for each folder a cycle of its files and subfolders."""
    found = []
    if ring := find_cycle(graph):
        found.append("files: " + " → ".join(ring))
    for folder in sorted({get_parent(module) for module in graph}):
        if ring := find_cycle(build_folder_graph(graph, folder)):
            examples = [find_example(graph, inner_folder, other) for inner_folder, other in pairwise(ring)]
            found.append("\n".join([f"in {folder or 'all'}: " + " → ".join(ring), *examples]))
    return found


def find_example(graph: Graph, inner_folder: str, other: str) -> str:
    """Find an import from one subfolder to another."""
    modules = (module for module in sorted(graph) if is_in_folder(module, inner_folder))
    return next(f"  {a} imports {b}" for a in modules for b in sorted(graph[a]) if is_in_folder(b, other))
