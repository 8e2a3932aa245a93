"""Running the stages of a scan: engine, limits, output folder, documents."""
