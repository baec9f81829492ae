"""What is looked at: reports, replays, views, live pages and logs."""
