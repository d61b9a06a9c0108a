// The two blocks of an ECP5 whose insides Yosys does not tell, as far as netlists of the core use them; buses instead of
// pins. Assumed, after Lattice's FPGA-TN-02204 (memory) and FPGA-TN-02205 (sysDSP); other uses stop the simulation.

// 512 words of 36 bits, 1024 of 18, 2048 of 9 or 4096 of 4, written by A alone, read by B alone; a word of 36 bits has its
// upper half at the pins of B, and all of it the clock and the enables of A to write, of B to read. Contents are random
// at the start. A word that is read while it is written is wrong in every bit, though the device may return the old or
// the new one.
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
  localparam UNUSED = DATA_WIDTH_A == 36 ? 5 : DATA_WIDTH_A == 18 ? 4 : DATA_WIDTH_A == 9 ? 3 : 2;  // bits of an address
  reg [35:0] words[0:4095];
  reg [35:0] read, read_s2;
  integer k;
  initial begin
    for (k = 0; k < 4096; k = k + 1) words[k] = {$random, $random};
    read = {$random, $random};
    read_s2 = {$random, $random};
  end

  // Wide words have an enable for each nine bits in the lowest bits of the address.
  wire [3:0] write = (DATA_WIDTH_A >= 18 ? ADA[3:0] : 4'b0001) & {4{CEA & WEA & ~|CSA}};
  wire [13:0] target = ADA >> UNUSED, source = ADB >> UNUSED;
  wire [35:0] written = {DIB, DIA};
  always @(posedge CLKA) for (k = 0; k < 4; k = k + 1) if (write[k]) words[target][9 * k +: 9] <= written[9 * k +: 9];

  always @(posedge CLKB) begin
    if (CEB & ~|CSB) read <= words[source] ^ {36{|write & target == source}};
    if (OCEB) read_s2 <= read;
    if (WEB | RSTA | RSTB) $stop;
  end
  wire [35:0] out = REGMODE_B == "OUTREG" ? read_s2 : read;
  assign DOB = DATA_WIDTH_B == 36 ? out[35:18] : out[17:0];
  assign DOA = DATA_WIDTH_B == 36 ? out[17:0] : 18'h2aaaa;
  initial begin
    if (DATA_WIDTH_A != 36 && DATA_WIDTH_A != 18 && DATA_WIDTH_A != 9 && DATA_WIDTH_A != 4) $stop;
    if (DATA_WIDTH_A != DATA_WIDTH_B || DATA_WIDTH_A == 36 && REGMODE_A != REGMODE_B) $stop;
    if (CLKAMUX != "CLKA" || CLKBMUX != "CLKB" || CSDECODE_A != "0b000" || CSDECODE_B != "0b000") $stop;
  end
endmodule

// 18 by 18 bits, each signed or not; at most a register before each, and one behind.
module MULT18X18D (
  input [17:0] A, B, C,
  input SIGNEDA, SIGNEDB, SOURCEA, SOURCEB, CLK0, CE0, CE1, CE2, CE3, RST0, RST1, RST2, RST3,
  output [35:0] P
);
  parameter REG_INPUTA_CLK = "NONE", REG_INPUTB_CLK = "NONE", REG_PIPELINE_CLK = "NONE", REG_OUTPUT_CLK = "NONE";
  parameter REG_INPUTA_CE = "CE0", REG_INPUTB_CE = "CE0", REG_INPUTA_RST = "RST0", REG_INPUTB_RST = "RST0";
  parameter REG_OUTPUT_CE = "CE0", REG_OUTPUT_RST = "RST0", CLK0_DIV = "ENABLED", RESETMODE = "SYNC", GSR = "ENABLED";
  reg [17:0] a_s1 = 0, b_s1 = 0;
  reg [35:0] product_s2 = 0;
  wire [17:0] a = REG_INPUTA_CLK == "NONE" ? A : a_s1, b = REG_INPUTB_CLK == "NONE" ? B : b_s1;
  wire signed [18:0] first = {SIGNEDA & a[17], a}, second = {SIGNEDB & b[17], b};
  wire signed [37:0] product = first * second;
  // Each register has one of four enables and resets, which its name's last character tells.
  wire [3:0] enables = {CE3, CE2, CE1, CE0}, resets = {RST3, RST2, RST1, RST0};
  localparam [23:0] ce_a = REG_INPUTA_CE, ce_b = REG_INPUTB_CE, ce_p = REG_OUTPUT_CE;
  localparam [31:0] rst_a = REG_INPUTA_RST, rst_b = REG_INPUTB_RST, rst_p = REG_OUTPUT_RST;
  always @(posedge CLK0) begin
    if (resets[rst_a[1:0]]) a_s1 <= 0; else if (enables[ce_a[1:0]]) a_s1 <= A;
    if (resets[rst_b[1:0]]) b_s1 <= 0; else if (enables[ce_b[1:0]]) b_s1 <= B;
    if (resets[rst_p[1:0]]) product_s2 <= 0; else if (enables[ce_p[1:0]]) product_s2 <= product[35:0];
  end
  assign P = REG_OUTPUT_CLK == "NONE" ? product[35:0] : product_s2;
  initial begin
    if (REG_PIPELINE_CLK != "NONE" || SOURCEA || SOURCEB || RESETMODE != "SYNC") $stop;
  end
endmodule
