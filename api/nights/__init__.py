"""The nights of the service's telescopes, and the word of safety that they hang on."""
