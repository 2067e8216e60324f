"""Zoo of random plants for the blind trial of the diagnosis.

The plants are distributed and share no code with the twins. See `README.md` of this folder.
"""
