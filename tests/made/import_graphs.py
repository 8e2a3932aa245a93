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
    """Imports between the modules of some packages, wherever they stand: in functions and for types, too.

    A compiled module is there by its stub. A string that is the name of a module counts as an import, since
    that is how modules are imported late and by name. The packages are imported from the package `inside`, if
    one is given, wherever their folders are.
    """
    files = [path for package in packages for path in (root / package).rglob("*.py*")]
    sources = [path for path in files if path.suffix in (".py", ".pyi")]
    modules = {to_module_name(inside / path.relative_to(root)): path for path in sources}
    return {
        name: set(find_python_imports(ast.parse(path.read_text(encoding="utf-8")), modules)) - {name}
        for name, path in modules.items()
    }


def find_python_imports(tree: ast.Module, modules: Collection[str]) -> Iterator[str]:
    """Those of `modules` that a module imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (owner for alias in node.names if (owner := find_owner(alias.name, modules)))
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (owner for name in names if (owner := find_owner(name, modules)))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and "." in node.value:
            yield from {node.value} & set(modules)


def build_rust_graph(source: Path) -> Graph:
    """Imports between the files of a crate: `use`, paths in the code, and `mod`.

    What unit tests import is left out: they may use everything, as the tests outside the crate do.
    """
    paths = {to_module_name("crate" / path.relative_to(source)): path for path in source.rglob("*.rs")}
    texts = {name: path.read_text(encoding="utf-8") for name, path in paths.items() if path.stem != "tests"}
    return {
        name: {owner for path in find_rust_paths(name, text) if (owner := find_owner(path, texts))} - {name}
        for name, text in texts.items()
    }


def find_rust_paths(name: str, text: str) -> Iterator[str]:
    """Every path within the crate that a file names, from the crate's root."""
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
    """Paths of a tree of `use`: `a::{b, c::{d, e}}` is a::b, a::c::d and a::c::e."""
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
    """A file's place in its tree as the name of a module."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] in ("__init__", "mod", "lib") else parts)


def get_parent(name: str) -> str:
    """The folder a module lies in."""
    return name.rpartition(".")[0]


def find_owner(name: str, modules: Collection[str]) -> str | None:
    """The module that a dotted name leads into, if it is one of `modules`."""
    while name and name not in modules:
        name = get_parent(name)
    return name or None


def is_within(module: str, room: str) -> bool:
    return not room or module == room or module.startswith(f"{room}.")


def build_folder_graph(graph: Graph, folder: str) -> Graph:
    """Imports between what stands in a folder, files and rooms, each room taken as one."""
    depth = folder.count(".") + 2 if folder else 1

    def get_entry(module: str) -> str:
        return ".".join(module.split(".")[:depth])

    rooms: Graph = {}
    for module, imported in graph.items():
        if module != folder and is_within(module, folder):
            others = {get_entry(to) for to in imported if to != folder and is_within(to, folder)}
            rooms.setdefault(get_entry(module), set()).update(others - {get_entry(module)})
    return rooms


def find_cycle(graph: Graph) -> list[str] | None:
    """A way along imports that ends where it began, if there is one; the same one each time."""
    imports = {module: sorted(graph[module]) for module in sorted(graph)}
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        ring = error.args[1][:0:-1]
        first = ring.index(min(ring))
        return [*ring[first:], *ring[: first + 1]]
    return None


def find_cycles(graph: Graph) -> list[str]:
    """A circle of files, and for each folder one of what stands in it, files and rooms; in words."""
    found = []
    if ring := find_cycle(graph):
        found.append("files: " + " → ".join(ring))
    for folder in sorted({get_parent(module) for module in graph}):
        if ring := find_cycle(build_folder_graph(graph, folder)):
            examples = [find_example(graph, room, other) for room, other in pairwise(ring)]
            found.append("\n".join([f"in {folder or 'all'}: " + " → ".join(ring), *examples]))
    return found


def find_example(graph: Graph, room: str, other: str) -> str:
    """A file of one room that imports one of another."""
    modules = (module for module in sorted(graph) if is_within(module, room))
    return next(f"  {a} imports {b}" for a in modules for b in sorted(graph[a]) if is_within(b, other))
