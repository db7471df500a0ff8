"""From detections to buildings: fused footprints, buildings as objects, and the evidence for them."""
