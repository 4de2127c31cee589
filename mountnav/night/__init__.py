"""A night without a human: frames come in, drift is measured, and by rules the mount is corrected.

``session`` runs it. ``rules`` decides: a pure function from ``events`` (what is known, what happened) to
decisions. ``frames_in`` takes frames, ``placing`` identifies them, ``parking`` says what is needed of a
telescope and parks it, ``memory`` writes down what a restart needs. ``recording`` keeps a night in a file;
``replay_inputs`` and ``replaying`` decide it again.
"""
