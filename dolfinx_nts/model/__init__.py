"""What a user declares, without contact: bodies, surfaces, obstacles, loads, supports."""
