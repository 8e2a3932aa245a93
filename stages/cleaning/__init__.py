"""What the clean stage is made of: one kind of defect a module."""
