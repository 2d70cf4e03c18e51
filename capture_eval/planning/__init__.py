"""Planning a capture: which combined expressions to photograph, in which order, and what that is worth."""
