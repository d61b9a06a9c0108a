/* One batch by registers alone: settings, events by AMD's AXI DMA (PG021, simple mode), result.
 * `core` and `dma` point at the registers. cmfpga_registers.h is what `cmfpga build --top kv260` wrote.
 * SPDX-License-Identifier: BSD-2-Clause */
#ifndef CMFPGA_H
#define CMFPGA_H
#include <stdint.h>

#include "cmfpga_registers.h"

typedef volatile uint32_t *cmfpga_words;

#ifndef CMFPGA_READ /* a test has its own */
#define CMFPGA_READ(base, offset) ((base)[(offset) / 4])
#define CMFPGA_WRITE(base, offset, word) ((base)[(offset) / 4] = (word))
#endif

#define DMA_CONTROL 0x00u /* bit 0: run */
#define DMA_STATUS 0x04u  /* bit 1: idle */
#define DMA_ADDRESS 0x18u /* low half; then the high one */
#define DMA_LENGTH 0x28u  /* bytes; a write starts */

struct cmfpga_result {
    int32_t v_x, v_y; /* px per half batch, with CMFPGA_FORMATS__V_FRAC_VALUE fraction bits */
    uint32_t flags, events, roi_next;
};

/* Settings of cmfpga_registers.h, and the start of one batch. -1: something else answers at this address. */
static inline int cmfpga_begin(cmfpga_words core)
{
    static const struct { uint32_t offset, word; } writes[] = {CMFPGA_SETTINGS};
    if (CMFPGA_READ(core, CMFPGA_ID) != CMFPGA_ID__MAGIC_VALUE ||
        CMFPGA_READ(core, CMFPGA_BUILD) != CMFPGA_BUILD__HASH_VALUE)
        return -1;
    for (uint32_t k = 0; k < sizeof writes / sizeof *writes; k++)
        CMFPGA_WRITE(core, writes[k].offset, writes[k].word);
    CMFPGA_WRITE(core, CMFPGA_OUTPUT, 0u); /* results in registers, none as packets */
    CMFPGA_WRITE(core, CMFPGA_ISR, CMFPGA_ISR__DONE_MASK);
    CMFPGA_WRITE(core, CMFPGA_CTRL, CMFPGA_CTRL__START_MASK);
    return 0;
}

/* `bytes` of event words at a physical address; the batch ends with them. */
static inline void cmfpga_send(cmfpga_words dma, uint64_t address, uint32_t bytes)
{
    CMFPGA_WRITE(dma, DMA_CONTROL, 1u);
    CMFPGA_WRITE(dma, DMA_ADDRESS, (uint32_t)address);
    CMFPGA_WRITE(dma, DMA_ADDRESS + 4u, (uint32_t)(address >> 32));
    CMFPGA_WRITE(dma, DMA_LENGTH, bytes);
}

/* -1: no result after so many looks. */
static inline int cmfpga_wait(cmfpga_words core, uint32_t looks, struct cmfpga_result *result)
{
    while (!(CMFPGA_READ(core, CMFPGA_ISR) & CMFPGA_ISR__DONE_MASK))
        if (!looks--)
            return -1;
    result->v_x = (int32_t)CMFPGA_READ(core, CMFPGA_RESULT_V_X);
    result->v_y = (int32_t)CMFPGA_READ(core, CMFPGA_RESULT_V_Y);
    result->flags = CMFPGA_READ(core, CMFPGA_RESULT_FLAGS);
    result->events = CMFPGA_READ(core, CMFPGA_RESULT_EVENTS);
    result->roi_next = CMFPGA_READ(core, CMFPGA_RESULT_ROI_NEXT);
    return 0;
}
#endif
