"""The multi-scale detector (Vu, Yamazaki and Matsuoka 2009): land cover by structure and colours."""
