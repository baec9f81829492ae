"""What a team flies besides: many targets, and ways through the air that do not cross."""
