"""Print the shares of phrases and names, and the findings."""

from __future__ import annotations

import sys
from collections import Counter

from tests.language.names import find_repeated_classes, list_functions
from tests.language.phrases import find_phrase
from tests.language.texts import read_texts


def main() -> None:
    """Print each share, then as many findings of each kind as `--list` asks for."""
    shown = int(sys.argv[sys.argv.index("--list") + 1]) if "--list" in sys.argv else 0
    total: Counter[str] = Counter()
    found: dict[str, list[str]] = {}
    for text in read_texts():
        total[text.kind] += 1
        advice = find_phrase(text.text)
        if advice:
            words = " ".join(text.text.split())[:100]
            found.setdefault(text.kind, []).append(f"{text.file}:{text.line}: {words}  [{advice}]")
    functions = list(list_functions())
    total["functions"] = len(functions)
    found["functions"] = [f"{f.file}:{f.line}: {f.name}" for f in functions if not f.begins_with_verb]
    total["lone words"] = len(functions)
    found["lone words"] = [f"{f.file}:{f.line}: {f.name}" for f in functions if f.lacks_noun]
    for kind, count in total.items():
        bad = found.get(kind, [])
        sys.stdout.write(f"{kind}: {len(bad)} of {count} ({100 * len(bad) / count:.1f} %)\n")
        sys.stdout.writelines(f"  {line}\n" for line in bad[:shown])
    for name, files in find_repeated_classes().items():
        sys.stdout.write(f"class {name} occurs in {', '.join(files)}\n")


if __name__ == "__main__":
    main()
