"""Parts of draw_sea.py and sea_of.py."""
