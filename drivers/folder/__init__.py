"""Folders into which another program saves its frames: as a camera, and watched for new files."""
