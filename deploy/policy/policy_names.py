"""Names in a policy's ONNX file."""

CONTRACT_KEY, GOLDEN_KEY = "firstshift.contract", "firstshift.golden"
"""Metadata: the contract, and observation-action pairs, both in JSON."""
INPUT, OUTPUT = "observation", "action"
MEMORY, NEXT = "memory", "next_memory"
"""Input and output of the recurrent state, of policies with memory."""
