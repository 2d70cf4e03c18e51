"""Expression editing from captured examples: drag points, get a face (paper 001)."""
