"""Steps of making a surface solid: closing borders, removing intersections, transferring colours."""
