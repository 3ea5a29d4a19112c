"""Pictures, films, MuJoCo's viewer and the live page."""
