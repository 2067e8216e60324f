"""What a healthy record says of noise and of the twin's own error."""
