"""Changes of a scan after it is read: up direction, scale, masks, adjusted cameras, undistortion."""
