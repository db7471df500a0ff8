"""An inventory over surveys: imported, measured, updated survey by survey, and one building across their borders."""
