"""Coverage analysis: holes, unseen space and weakly observed surface of a scan."""
