"""Names and texts use the language of the field, as far as a program can check."""

from collections import Counter

import pytest

from tests.language.names import find_repeated_classes, list_functions
from tests.language.phrases import PHRASES, find_phrase
from tests.language.texts import read_texts

# Maximum shares over the repository, because a reader may decide for single exceptions.
MAX_FLAGGED = 0.03
MIN_VERBS = 0.6


def test_phrases_to_avoid_are_rare():
    total: Counter[str] = Counter()
    flagged: dict[str, list[str]] = {}
    for text in read_texts():
        total[text.kind] += 1
        advice = find_phrase(text.text)
        if advice:
            flagged.setdefault(text.kind, []).append(f"{text.file}:{text.line}: {text.text[:80]} ({advice})")
    of_tests = {"docstrings of tests", "comments of tests"}
    assert set(total) == {"docstrings", "comments", "Rust comments", "lines of documentation"} | of_tests
    over = {kind: found for kind, found in flagged.items() if len(found) > MAX_FLAGGED * total[kind]}
    assert not over, "\n".join(line for found in over.values() for line in found)


def test_function_names_begin_with_verbs():
    functions = list(list_functions())
    others = [function for function in functions if not function.begins_with_verb]
    assert len(others) <= (1 - MIN_VERBS) * len(functions), others


def test_no_name_is_a_lone_participle_preposition_or_pronoun():
    assert [function for function in list_functions() if function.lacks_noun] == []


def test_no_class_name_occurs_twice_in_stages():
    assert find_repeated_classes() == {}


@pytest.mark.parametrize(
    "text",
    [
        "What it holds.",
        "Return how far it is.",
        "It tells the scale.",
        "The one beside it.",
        "The poses of one and those of another.",
    ],
)
def test_a_phrase_is_found(text):
    assert find_phrase(text) is not None


def test_plain_sentences_pass():
    assert find_phrase("Estimate the up direction of a scan.") is None
    assert find_phrase("If the mesh has no colour, what remains is grey.") is None
    assert len(PHRASES) > 10
