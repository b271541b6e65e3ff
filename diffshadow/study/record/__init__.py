"""Records: what is known of a finished run, sweep or recommendation, how it is stored in a folder, and read again."""
