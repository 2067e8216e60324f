"""Faulty links and replies on request."""
