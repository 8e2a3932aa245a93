"""Method `planar`: near-planar patches, each triangulated anew within its border (Chen and Qin)."""
