"""What a record holds: blocks of it, its noise, which of its readings may be used."""
