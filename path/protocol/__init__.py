"""The hand-over protocol: both sides as pure state machines (``sender``, ``receiver``) over
``values``.

No protocol gives certainty over a link that may die at any message, so responsibility moves by
leases on aligned clocks: the sender releases, then sends COMMIT with the lease's end; the receiver
holds provisionally and sends ACCEPT; the sender answers every ACCEPT with CONFIRM, and the receiver
holds for good. Without CONFIRM by the lease's end the receiver lets go; without ACCEPT by the
lease's end and the clocks' uncertainty the sender takes back. What is left is one gap: an ACCEPT
that arrived and a CONFIRM that did not leave nobody responsible (``orphaned``); both sides alarm.
"""
