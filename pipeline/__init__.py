"""From a scan folder to artifacts: stage graph, config, cache."""

if __name__ == "pipeline":
    # Imported from the top of a checkout: the modules are those of `scanloom.pipeline`, not second copies.
    from importlib import import_module

    import_module("scanloom").add_alias(__name__)
