"""Constants of the dither: the R2 low-discrepancy sequence in two dimensions.

Martin Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences" (2018): α = (1/g, 1/g²) with g³ = g + 1.
Events sit on whole pixels, which makes v = 0 a peak of the contrast whatever the motion is; an offset that covers the
pixel evenly removes that peak.
"""

#: α of columns and rows.
R2 = (0.7548776662466927, 0.5698402909980532)

#: Fraction bits of the running sum.
DITHER_BITS = 24

#: α, raw with :data:`DITHER_BITS` fraction bits.
FACTORS = tuple(round(alpha * 2**DITHER_BITS) for alpha in R2)
