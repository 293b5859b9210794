"""One parameter from prior knowledge, while data arrive: which one changed, when, and by how much."""
