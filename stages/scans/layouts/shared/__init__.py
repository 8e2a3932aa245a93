"""Code shared by several layouts: views, phones, gravity."""
