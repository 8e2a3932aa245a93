"""What several layouts share: views, phones, gravity."""
