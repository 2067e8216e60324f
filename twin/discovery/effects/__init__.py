"""Effects that a twin may lack: candidates, their laws and time courses, and their influence on the readings."""
