"""Pipeline from a scan folder to result files: stage graph, configuration, cache."""

if __name__ == "pipeline":
    # Imported from the root of a checkout: alias `scanloom.pipeline`, so that no module is loaded twice.
    from importlib import import_module

    import_module("scanloom").add_alias(__name__)
