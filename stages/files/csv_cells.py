"""Cells of CSV files that spreadsheet programs must not execute."""

from __future__ import annotations

# Spreadsheet programs read a cell with one of these first characters as a formula, after white space too.
_FORMULA_SIGNS = ("=", "+", "-", "@", "\t", "\r", "|", "%", "\uff1d", "\uff0b", "\uff0d", "\uff20")


def neutralize_csv_cell(text: str) -> str:
    """Return text of a cell so that no spreadsheet program reads it as a formula.

    A leading apostrophe marks the cell as text. Control characters except line feeds are replaced.
    """
    text = "".join("\ufffd" if (c < " " and c not in "\n\t") or "\x7f" <= c < "\xa0" else c for c in text)
    is_formula = text.lstrip(" \n").startswith(_FORMULA_SIGNS)
    return f"'{text}" if is_formula else text
