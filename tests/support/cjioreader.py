"""cjio as a reader: when it is loaded it makes Python's writer of JSON round all numbers; here that is put back."""

import json
import warnings

made = json.encoder.c_make_encoder
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of the library when it is loaded
    from cjio import cityjson
json.encoder.c_make_encoder = made
vars(json.encoder).pop("float", None)

__all__ = ["cityjson"]
