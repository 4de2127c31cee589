"""Navigation decides: look, sync or not, center, recover, flip. All motion goes through the room `mount`.

``navigator`` is the face, over what ``equipment`` puts together; ``mount_orders`` holds one piece of work at
a time, and has the orders that need no camera. ``policy`` and ``sync_policy`` are an operator's values,
``reports`` the answers.

==================== =========================================================================================
a look               ``look`` (expose and solve), ``look_retries`` (until one is solved), ``frames_seen`` (is
                     the frame new?), ``camera`` and ``learned`` (what is usual for the camera)
a sync               ``sync_trigger``, ``vetoes``, ``sync_judge`` (whether), ``sync`` and ``sync_transaction``
                     (how), ``sync_to_coordinates`` (without a look)
a centering          ``centering``, ``correcting``, ``steering``, ``tries``, ``slewing``
a lost mount         ``recovering``, ``first_light``
others' frames       ``outside_frames``, ``reading_history``
==================== =========================================================================================
"""
