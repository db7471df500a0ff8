"""Four detectors of buildings that do not know each other, behind one interface."""
