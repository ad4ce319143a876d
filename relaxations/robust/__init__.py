"""One command for a whole box of plants: the box, the search for its samples, the proof over all of it."""
