"""Whatever bytes strangers send, as a frame, a file, a message: a parser answers, or gives its own error.

``python -m tests.fuzz --seconds 60`` gives each target so long, guided by coverage where atheris is installed
(``pip install atheris``), else by chance. ``make test`` runs each over its corpus and a few mutations of it.
"""
