"""Method `cut`: what is above a height falls away. Made up, to be added to the table by a test."""
