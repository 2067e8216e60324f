"""Commands of `hil bench`."""
