"""Laws outside the catalogue: any recorded input or temperature as driver, in several forms, at every site of a
network.
"""
