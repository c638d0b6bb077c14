"""Edge-to-edge contact: sharp edges and the pairs of them that cross."""
