"""Constants of the dither: the R2 low-discrepancy sequence in two dimensions.

Martin Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences" (2018): α = (1/g, 1/g²) with g³ = g + 1.
Events sit on whole pixels, which makes v = 0 a peak of the contrast whatever the motion is; an offset that covers the
pixel evenly removes that peak.
"""

#: Fraction bits of the running sum.
DITHER_BITS = 24

#: α of columns and rows, raw with :data:`DITHER_BITS` fraction bits.
FACTORS = (12664746, 9560334)
