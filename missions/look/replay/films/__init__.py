"""The method over recordings that were made without PATH (``path-handoff replay films.toml``)."""
