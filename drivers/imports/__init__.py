"""Rig files made of what a user already has: vendor tables, Telegraf, Home Assistant, DBC. Nothing is sent anywhere."""
