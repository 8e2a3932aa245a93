"""Export for physics simulators: collision geometry with proven bounds, mass, descriptions."""
