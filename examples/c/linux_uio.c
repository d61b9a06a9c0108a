/* A batch under Linux: registers by UIO, event words in a u-dma-buf.
 *     linux_uio /dev/uio0 /dev/uio1 /dev/udmabuf0 PHYSICAL_ADDRESS < words
 * SPDX-License-Identifier: BSD-2-Clause */
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <unistd.h>

#include "cmfpga.h"

#define SIZE 0x10000u /* of both devices' registers, and of the buffer */

static void *map(const char *path)
{
    int file = open(path, O_RDWR | O_SYNC);
    void *words = file < 0 ? MAP_FAILED : mmap(NULL, SIZE, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (words == MAP_FAILED) {
        perror(path);
        exit(2);
    }
    close(file);
    return words;
}

int main(int count, char **argument)
{
    if (count != 5) {
        fprintf(stderr, "usage: linux_uio CORE DMA BUFFER PHYSICAL_ADDRESS < words\n");
        return 2;
    }
    cmfpga_words core = map(argument[1]), dma = map(argument[2]);
    size_t bytes = fread(map(argument[3]), 1, SIZE, stdin);
    struct cmfpga_result result;
    if (cmfpga_begin(core)) {
        fprintf(stderr, "%s: not the core that cmfpga_registers.h is of\n", argument[1]);
        return 1;
    }
    cmfpga_send(dma, strtoull(argument[4], NULL, 0), (uint32_t)bytes);
    if (cmfpga_wait(core, 1000000u, &result)) {
        fprintf(stderr, "no result\n");
        return 1;
    }
    double one = 1 << CMFPGA_FORMATS__V_FRAC_VALUE;
    printf("v = %g, %g px per half batch; flags %#x; %u events\n", result.v_x / one, result.v_y / one, result.flags,
           result.events);
    return 0;
}
