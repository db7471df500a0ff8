"""From detections to buildings: which cells are building, buildings as objects, and the evidence for them."""
