/* A batch on a processor without an operating system; addresses are those of the KV260's design.
 * SPDX-License-Identifier: BSD-2-Clause */
#include "cmfpga.h"

#define CORE ((cmfpga_words)0xA0000000u)
#define DMA ((cmfpga_words)0xA0010000u)

/* Event words, in memory that the DMA reads and no cache holds back. 0, or -1 where something is wrong. */
int cmfpga_batch(uint64_t events, uint32_t bytes, struct cmfpga_result *result)
{
    if (cmfpga_begin(CORE))
        return -1;
    cmfpga_send(DMA, events, bytes);
    return cmfpga_wait(CORE, 1000000u, result);
}
