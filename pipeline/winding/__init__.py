"""The winding scene: its file, its runs, what they say of the paper, and where they are kept."""
