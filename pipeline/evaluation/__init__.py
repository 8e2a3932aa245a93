"""What the stage `report` measures and draws."""
