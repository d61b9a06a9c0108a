// The blocks of a Gowin GW2A whose insides Yosys does not tell, as far as netlists of the core use them. Assumed, after
// Gowin's UG285 (BSRAM) and UG287 (DSP); other uses stop the simulation.

// 2048 words of 9 bits or 1024 of 18, written by A alone, read by B; the lowest two bits of A's address enable halves of 18
// bits. Contents are random at the start. A word that is read while it is written is wrong in every bit.
module DPX9B (
  input CLKA, CEA, OCEA, WREA, RESETA, CLKB, CEB, OCEB, WREB, RESETB,
  input [2:0] BLKSELA, BLKSELB,
  input [13:0] ADA, ADB,
  input [17:0] DIA, DIB,
  output [17:0] DOA, DOB
);
  parameter BIT_WIDTH_0 = 18, BIT_WIDTH_1 = 18, READ_MODE0 = 0, READ_MODE1 = 0, WRITE_MODE0 = 0, WRITE_MODE1 = 0;
  parameter BLK_SEL_0 = 0, BLK_SEL_1 = 0, RESET_MODE = "SYNC";
  localparam WIDE = BIT_WIDTH_0 == 18, UNUSED = WIDE ? 4 : 3;  // bits of an address
  reg [17:0] words[0:2047];
  reg [17:0] read;
  integer k;
  initial begin
    for (k = 0; k < 2048; k = k + 1) words[k] = $random;
    read = $random;
    if (BIT_WIDTH_0 != BIT_WIDTH_1 || BIT_WIDTH_0 != 18 && BIT_WIDTH_0 != 9) $stop;
    if (READ_MODE0 != 0 || READ_MODE1 != 0 || BLK_SEL_0 != 0 || BLK_SEL_1 != 0) $stop;
  end
  wire [1:0] write = (WIDE ? ADA[1:0] : 2'b01) & {2{CEA & WREA}};
  wire [13:0] target = ADA >> UNUSED, source = ADB >> UNUSED;
  always @(posedge CLKA) for (k = 0; k < 2; k = k + 1) if (write[k]) words[target][9 * k +: 9] <= DIA[9 * k +: 9];
  always @(posedge CLKB) begin
    if (CEB) read <= words[source] ^ {18{|write & target == source}};
    if (WREB | RESETA | RESETB | |BLKSELA | |BLKSELB) $stop;
  end
  assign DOA = 18'h2aaaa, DOB = read;
endmodule

// Each factor signed or not; no registers.
module MULT9X9 (
  input [8:0] A, B, SIA, SIB,
  input ASIGN, BSIGN, ASEL, BSEL, CE, CLK, RESET,
  output [17:0] DOUT
);
  assign DOUT = $signed({ASIGN & A[8], A}) * $signed({BSIGN & B[8], B});
  always @(ASEL, BSEL) if (ASEL | BSEL) $stop;
endmodule

module MULT18X18 (
  input [17:0] A, B, SIA, SIB,
  input ASIGN, BSIGN, ASEL, BSEL, CE, CLK, RESET,
  output [35:0] DOUT
);
  assign DOUT = $signed({ASIGN & A[17], A}) * $signed({BSIGN & B[17], B});
  always @(ASEL, BSEL) if (ASEL | BSEL) $stop;
endmodule
