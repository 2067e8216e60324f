"""Score tests of candidate effects on one quadratic form, with tunables and known structure projected out."""
