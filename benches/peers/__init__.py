"""Other tools' simplifiers, called the way their users call them, for benches/simplify.py."""
