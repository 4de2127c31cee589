"""The NexStar protocol of Celestron hand controls: codec, mount, and a fake that answers it."""
