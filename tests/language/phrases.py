"""Phrases that readers of the field stumble over, and the words to use in their place."""

from __future__ import annotations

import re

# A phrase is a hint, not a proof, because some sentences need it: the test limits the share of all texts.
PHRASES: tuple[tuple[str, str], ...] = (
    (r"^(?:Return )?(?:what|how|whether|which|where|who)\b(?! if)", "begin with the noun that is meant"),
    (r"\b(?:tells?|told|says of|said of|is said|are said)\b", "warn, report, state or estimate"),
    (r"\b(?:is|are|was|were) none\b|\bof nothing\b", "is invalid, does not exist, or no …"),
    (r"\b(?:so many|as many as|so far as|as much as there is)\b", "name the quantity"),
    (r"\b(?:that|those) of\b", "repeat the noun"),
    (r"\b(?:stands?|lies?) (?:beside|in|with|at)\b", "is in, is stored in, is next to"),
    (r"\bbeside\b", "next to, with, or in addition to"),
    (r"\bof (?:its|their) own\b", "separate, or own before the noun"),
    (r"\b(?:least|most)_|_(?:least|most)\b", "min_ and max_"),
    (r"\bfor (?:it|they|that|those|there) (?:is|are|was|were)\b", "because"),
    (r"\bwhich of\b.*\bis\b.*\bthat\b", "two sentences"),
    (r"\b(?:goes on|went on|go on) (?:with|until|to)\b|\bin silence\b", "continue; silently"),
    (r"\bmade (?:lighter|larger|smaller|anew)\b|\banew\b", "simplify, enlarge, reduce; again"),
    (r"\b(?:begun|given up|at the most|parted|at hand)\b", "started, abandoned, at most, separate"),
    (r"\b(?:is|are|was|were) as good as\b|\bby (?:itself|themselves)\b", "name the limit; alone"),
    (r"\bgo(?:es)? on\b|\bwhole way\b|\ball else\b", "continue; all stages; everything else"),
    (r"\b(?:is|are|was|were|be) off by\b(?! default)", "has an error of"),
    (r"\bput right\b|\btaken for granted\b|\bof (?:late|old)\b", "repair, assume"),
)
_COMPILED = tuple((re.compile(pattern, re.IGNORECASE), advice) for pattern, advice in PHRASES)


def find_phrase(text: str) -> str | None:
    """Find the first phrase to avoid; return the words to use in its place."""
    return next((advice for pattern, advice in _COMPILED if pattern.search(text.strip())), None)
