"""``path-handoff checklist``: one page of paper of what a rig's crew does, in order."""
