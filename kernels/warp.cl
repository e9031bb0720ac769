// Warps an image through a map: out(x, y) = in(map(x, y)), bilinear, rounded to nearest, 0 where the
// map leaves [0, in_width - 1] x [0, in_height - 1].
// Layout: images 8-bit, row-major, pitch = width; map: (x, y) pairs, row-major.
// Launch: x >= width, y >= height; one pixel each.

#ifdef CORVID_PLANT_FAULT
#define HALF_PIXEL 0.1f
#else
#define HALF_PIXEL 0.0f
#endif

__kernel void warp(__global const uchar* restrict in, int in_width, int in_height,
                   __global const float2* restrict map, __global uchar* restrict out, int width,
                   int height) {
  const int x = get_global_id(0);
  const int y = get_global_id(1);
  if (x >= width || y >= height) return;
  const size_t at = (size_t)y * width + x;
  const float2 p = map[at] + HALF_PIXEL;
  uchar value = 0;
  if (p.x >= 0.0f && p.y >= 0.0f && p.x <= in_width - 1.0f && p.y <= in_height - 1.0f) {
    const int x0 = (int)p.x, y0 = (int)p.y;
    const int right = min(x0 + 1, in_width - 1), below = min(y0 + 1, in_height - 1);
    const float fx = p.x - x0, fy = p.y - y0;
    __global const uchar* above_row = in + (size_t)y0 * in_width;
    __global const uchar* below_row = in + (size_t)below * in_width;
    const float top = mix((float)above_row[x0], (float)above_row[right], fx);
    const float bottom = mix((float)below_row[x0], (float)below_row[right], fx);
    value = convert_uchar_sat_rte(mix(top, bottom, fy));
  }
  out[at] = value;
}
