"""What users declare, apart from contact: bodies, surfaces, obstacles, loads, supports."""
