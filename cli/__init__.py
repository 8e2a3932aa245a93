"""The scanloom command."""

if __name__ == "cli":
    # Imported from the top of a checkout: the modules are those of `scanloom.cli`, not second copies.
    from importlib import import_module

    import_module("scanloom").add_alias(__name__)
