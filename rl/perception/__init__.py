"""What missions put into a world beside vehicles: tracks, obstacles, and what vehicles see of them."""
