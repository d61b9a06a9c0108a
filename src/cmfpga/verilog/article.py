"""What the article says of its own design on the KV260, to compare with: a batch, its cycles, the resources."""

#: Events of the batch that the article times, and those of them in its ROI of 64×64 px.
BATCH = {"events": 5000, "roi_events": 800}

#: Of its core, 64×64 px, without AXI: Vivado's figures.
RESOURCES = {"lut": 3655, "ff": 7857, "carry8": 274, "bram36": 25.5, "uram": 0, "dsp": 151}


def cycles(*, events, roi_events, pixels, iterations):
    """C_batch of the article: N + T·(n + L_r + P/4 + L_v) with L_r = 32 and L_v = 35."""
    return events + iterations * (roi_events + 32 + pixels // 4 + 35)
