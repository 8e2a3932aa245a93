"""What same_outputs.py runs, and how it compares what comes out; it names nothing inside a checkout."""
