"""Photos: heads with known truth, the virtual photographer, checks of real photos."""
