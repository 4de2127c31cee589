"""What may be ordered of a telescope, by whatever face: vocabulary, dispatcher, jobs and their results."""
