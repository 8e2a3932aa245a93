"""User-supplied neural networks for depth: sidecar, inputs and outputs, subprocesses."""
