"""Generated blocks of pages: valid Markdown, complete, and the same in each run."""

import re
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from making import commands, page_blocks, parameters, python
from making.docstrings import convert_docstring
from making.markdown import escape_markdown, format_code, format_definitions
from markdown_it import MarkdownIt

import scanloom
from scanloom import stages
from scanloom.pipeline.config import Config
from scanloom.stages.params import describe_all

# Words and all characters with a meaning in Markdown.
TEXTS = st.text(st.sampled_from("ab *_<>[]|#$~{}\\&!1.-"), min_size=1).map(lambda text: f"a{text}z")


def render_text(markdown: str) -> str:
    """Render Markdown and remove the tags."""
    html = MarkdownIt("commonmark").render(markdown)
    text = re.sub(r"<[^>]*>", "", html).strip()
    for sign, name in (("<", "&lt;"), (">", "&gt;"), ('"', "&quot;"), ("&", "&amp;")):
        text = text.replace(name, sign)
    return text


@given(TEXTS)
def test_a_text_is_shown_as_it_is(text: str):
    assert render_text(escape_markdown(text)) == text


@given(st.text(st.sampled_from("ab `*_"), min_size=1).map(lambda text: f"a{text}z"))
def test_code_is_shown_as_it_is(text: str):
    assert render_text(format_code(text)) == text


def test_a_definition_has_a_term_a_meaning_and_facts():
    assert format_definitions([("`a`", "what it is.", "m; at least 0"), ("`b`", "another.", "")]) == (
        "`a`\n: what it is.\n\n  *m; at least 0*\n\n`b`\n: another.\n"
    )


DOCSTRING = """Do what it says, in `code`.

    >>> do(1)
    2

    Parameters
    ----------
    mesh : (n, 3) float64, metres; `None` for
        none.
    params, **changes : see Params.

    Returns
    -------
    (h, w) uint8, of its size.

    Raises
    ------
    InputError
        If *it* is wrong.
    """
MARKDOWN = """Do what it says, in `code`.

```python
>>> do(1)
2
```

**Parameters**

`mesh`
: (n, 3) float64, metres; `None` for none.

`params, **changes`
: see Params.


**Returns**

(h, w) uint8, of its size.

**Raises**

`InputError`
: If \\*it\\* is wrong.
"""


def test_a_docstring_becomes_lists():
    assert convert_docstring(DOCSTRING) == MARKDOWN


@pytest.mark.parametrize("section", Config.get_types())
def test_every_parameter_is_listed_in_its_section(section: str):
    listed = parameters.list_section(section)
    params = getattr(Config(), section)

    for name, about in describe_all(type(params)).items():
        assert f"`{section}.{name}`\n: {escape_markdown(about.text.split()[0])}" in listed
    assert f"## `[{section}]`" in parameters.list_all_sections()


def test_defaults_come_from_the_section():
    assert "default: 200000" in parameters.list_section("compare")


def test_every_command_and_option_is_there():
    text = commands.write_reference()

    for name, command in commands.list_commands():
        section = text.split(f"## {name}\n")[1].split("\n## ")[0]
        for parameter in command.params:
            for option in [*parameter.opts, *parameter.secondary_opts]:
                if option.startswith("--") and not getattr(parameter, "hidden", False):
                    assert re.search(rf"`[^`]*{option}\b", section), f"{name} {option}"


def test_every_public_name_is_there():
    text = python.write_reference()

    for package, prefix in ((scanloom, ""), (stages.lod, "lod.")):
        for name in set(package.__all__) - {"__version__"}:
            assert f"### `{prefix}{name}`" in text


@pytest.mark.parametrize("maker", ["configuration", "commands", "python", "guides"])
def test_generators_are_deterministic(maker: str):
    made: Any = page_blocks.GENERATORS[maker]

    assert made() == made()
    assert not re.search(r"0x[0-9a-f]{6,}|<function|/home/|bound method", made())


def test_a_block_is_replaced_by_its_generated_content():
    text = "before\n\n```{made} parameters cache\nwhat a reader of the page sees\n```\n\nafter\n"

    filled = page_blocks.fill_blocks(text)

    assert filled.startswith("before\n\n`cache.max_size`\n: ")
    assert filled.endswith("\n\nafter\n")
    assert "what a reader" not in filled
