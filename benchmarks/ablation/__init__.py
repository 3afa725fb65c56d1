"""What each search and check of predict and verify contributes: the same trials with one stage left out at a time."""
