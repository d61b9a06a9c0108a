// The two blocks of an ECP5 whose insides Yosys does not tell, as far as netlists of the core use them; buses instead of
// pins. Assumed, after Lattice's FPGA-TN-02204 (memory) and FPGA-TN-02205 (sysDSP); other uses stop the simulation.

// 1024 words of 18 bits or 2048 of 9, written by A alone, read by B alone. Contents are random at the start. A word that
// is read while it is written is wrong in every bit, though the device may return the old or the new one.
module DP16KD (
  input CLKA, CEA, OCEA, WEA, RSTA, CLKB, CEB, OCEB, WEB, RSTB,
  input [2:0] CSA, CSB,
  input [13:0] ADA, ADB,
  input [17:0] DIA, DIB,
  output [17:0] DOA, DOB
);
  parameter DATA_WIDTH_A = 18, DATA_WIDTH_B = 18, REGMODE_A = "NOREG", REGMODE_B = "NOREG", GSR = "ENABLED";
  parameter RESETMODE = "SYNC", ASYNC_RESET_RELEASE = "SYNC", CSDECODE_A = "0b000", CSDECODE_B = "0b000";
  parameter WRITEMODE_A = "NORMAL", WRITEMODE_B = "NORMAL", CLKAMUX = "CLKA", CLKBMUX = "CLKB";
  reg [8:0] low[0:1023], high[0:1023];
  reg [17:0] read, read_s2;
  integer k;
  initial for (k = 0; k < 1024; k = k + 1) {high[k], low[k]} = $random;

  // Words of 18 bits have an enable for each half in the lowest bits of the address.
  wire [1:0] enabled = DATA_WIDTH_A == 18 ? ADA[1:0] : {ADA[3], ~ADA[3]};
  wire [1:0] write = enabled & {2{CEA & WEA & ~|CSA}};
  always @(posedge CLKA) begin
    if (write[0]) low[ADA[13:4]] <= DIA[8:0];
    if (write[1]) high[ADA[13:4]] <= DATA_WIDTH_A == 18 ? DIA[17:9] : DIA[8:0];
  end

  wire [17:0] word = {high[ADB[13:4]], low[ADB[13:4]]} ^ {18{|write & ADA[13:4] == ADB[13:4]}};
  always @(posedge CLKB) begin
    if (CEB & ~|CSB) read <= DATA_WIDTH_B == 18 ? word : ADB[3] ? {9'h155, word[17:9]} : {9'h0aa, word[8:0]};
    if (OCEB) read_s2 <= read;
    if (WEB | RSTA | RSTB) $stop;
  end
  assign DOB = REGMODE_B == "OUTREG" ? read_s2 : read;
  assign DOA = 18'h2aaaa;
  initial begin
    if (DATA_WIDTH_A != 9 && DATA_WIDTH_A != 18 || DATA_WIDTH_B != 9 && DATA_WIDTH_B != 18) $stop;
    if (CLKAMUX != "CLKA" || CLKBMUX != "CLKB" || CSDECODE_A != "0b000" || CSDECODE_B != "0b000") $stop;
  end
endmodule

// 18 by 18 bits, each signed or not; at most a register behind.
module MULT18X18D (
  input [17:0] A, B, C,
  input SIGNEDA, SIGNEDB, SOURCEA, SOURCEB, CLK0, CE0, RST0,
  output [35:0] P
);
  parameter REG_INPUTA_CLK = "NONE", REG_INPUTB_CLK = "NONE", REG_PIPELINE_CLK = "NONE", REG_OUTPUT_CLK = "NONE";
  parameter REG_OUTPUT_CE = "CE0", REG_OUTPUT_RST = "RST0", CLK0_DIV = "ENABLED", RESETMODE = "SYNC", GSR = "ENABLED";
  reg [35:0] product_s2;
  wire signed [18:0] a = {SIGNEDA & A[17], A}, b = {SIGNEDB & B[17], B};
  wire signed [37:0] product = a * b;
  always @(posedge CLK0) begin
    if (RST0) product_s2 <= 0;
    else if (CE0) product_s2 <= product[35:0];
  end
  assign P = REG_OUTPUT_CLK == "NONE" ? product[35:0] : product_s2;
  initial begin
    if (REG_INPUTA_CLK != "NONE" || REG_INPUTB_CLK != "NONE" || REG_PIPELINE_CLK != "NONE" || SOURCEA || SOURCEB) $stop;
  end
endmodule
