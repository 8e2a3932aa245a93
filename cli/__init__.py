"""The scanloom command."""

if __name__ == "cli":
    # Imported from the top of a checkout: use `scanloom.cli`, so that no module is loaded twice.
    from importlib import import_module

    import_module("scanloom").add_alias(__name__)
