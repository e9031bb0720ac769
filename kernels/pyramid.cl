// Halves an image: out(x, y) = round(sum_ij b_i b_j in(2x + i, 2y + j)), b = [1 4 6 4 1] / 16,
// i, j = -2..2, border pixels repeated. Exact in integers.
// Layout: 8-bit, row-major, pitch = width, readable 64 bytes past the end.
// Launch: x >= ceil(out_width / 16), y >= out_height; each work-item makes 16 pixels of a row.

#ifdef CORVID_PLANT_FAULT
#define CENTRE 7
#else
#define CENTRE 6
#endif

inline ushort16 even_bytes(__global const uchar* p) {
  return (ushort16)(convert_ushort8(vload16(0, p).even), convert_ushort8(vload16(1, p).even));
}
inline ushort16 odd_bytes(__global const uchar* p) {
  return (ushort16)(convert_ushort8(vload16(0, p).odd), convert_ushort8(vload16(1, p).odd));
}

__kernel void halve(__global const uchar* restrict in, int width, int height,
                    __global uchar* restrict out, int out_width, int out_height) {
  const int x0 = get_global_id(0) * 16;
  const int y = get_global_id(1);
  if (x0 >= out_width || y >= out_height) return;
  const ushort b[5] = {1, 4, CENTRE, 4, 1};
  const int left = 2 * x0 - 2;
  if (left >= 0 && left + 36 <= width && x0 + 16 <= out_width) {
    ushort16 sum = 0;  // at most 16 * 16 * 255 < 2^16
    for (int j = 0; j < 5; ++j) {
      const int row = clamp(2 * y + j - 2, 0, height - 1);
      __global const uchar* p = in + (size_t)row * width + left;
      const ushort16 e0 = even_bytes(p), e2 = even_bytes(p + 2), e4 = even_bytes(p + 4);
      const ushort16 o1 = odd_bytes(p), o3 = odd_bytes(p + 2);
      sum += b[j] * (e0 + e4 + (ushort)4 * (o1 + o3) + (ushort)CENTRE * e2);
    }
    vstore16(convert_uchar16((sum + (ushort)128) >> (ushort)8), 0,
             out + (size_t)y * out_width + x0);
    return;
  }
  for (int x = x0; x < min(x0 + 16, out_width); ++x) {
    uint sum = 128;
    for (int j = 0; j < 5; ++j) {
      __global const uchar* p = in + (size_t)clamp(2 * y + j - 2, 0, height - 1) * width;
      for (int i = 0; i < 5; ++i) sum += (uint)b[j] * b[i] * p[clamp(2 * x + i - 2, 0, width - 1)];
    }
    out[(size_t)y * out_width + x] = (uchar)(sum >> 8);
  }
}
