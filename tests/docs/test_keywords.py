"""Generated modules for type checkers are up to date and are never imported."""

import ast

from making import keywords

from scanloom import stages


def test_the_keyword_module_is_up_to_date():
    assert keywords.KEYWORDS.read_text(encoding="utf-8") == keywords.write_keywords()


def test_the_package_names_are_up_to_date():
    assert keywords.PACKAGE.read_text(encoding="utf-8") == keywords.write_package()


def test_a_new_name_in_the_table_is_imported_and_listed(monkeypatch):
    monkeypatch.setitem(stages._NAMES_OF, "progress", ("silent",))
    monkeypatch.setitem(stages._MODULE_OF, "silent", "scanloom.stages.progress")

    text = keywords.write_package()

    assert "\n    from scanloom.stages.progress import silent\n" in text
    assert '\n    "repair",\n    "silent",\n    "simplify",\n' in text


def test_every_field_of_a_parameter_class_is_a_keyword():
    tree = ast.parse(keywords.write_keywords())
    written = {node.name: node.body[1:] for node in tree.body if isinstance(node, ast.ClassDef)}
    classes = keywords.find_classes()

    assert {"FuseParams", "SimplifyParams", "Mesh"} <= {cls.__name__ for cls in classes}
    assert list(written) == [keywords.get_keywords_name(cls) for cls in classes]
    for cls in classes:
        names = [node.target.id for node in written[keywords.get_keywords_name(cls)]]
        assert names == list(cls.__dataclass_fields__)
