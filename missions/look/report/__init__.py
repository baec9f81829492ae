"""The report of a run: records, figures, pictures, and what a person sees while it goes on."""
