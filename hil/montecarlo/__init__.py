"""Monte-Carlo hand-overs: many attempts without flights."""
