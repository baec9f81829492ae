"""The paper's arithmetic of errors."""
