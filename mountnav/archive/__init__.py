"""Archives of frames: a work list, a store of results that only grows, and what can be said of both.

It knows files and tables, and solves nothing: `api.archive` sends the frames to processes.
"""
