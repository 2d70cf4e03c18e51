"""Edge-loop curves of a quad mesh."""
