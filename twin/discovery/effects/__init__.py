"""What a twin may lack: candidates, their laws and shapes, and what each would do to the readings."""
