"""Archives of frames solved: what `mountnav.archive` knows of, sent to processes that solve."""
