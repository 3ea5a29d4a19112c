"""Pictures, films and the live page."""
