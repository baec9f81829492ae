"""The paper's evaluation as trials that anyone can run: ``path-handoff trial NAME``."""
