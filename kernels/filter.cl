// Gaussian filter, separable, border pixels repeated:
//   out(x, y) = sum_ij taps[|i|] taps[|j|] in(x + i, y + j), i, j = -radius..radius
// A work-group makes `rows` rows of a tile of TILE columns, each in two steps: sums down the columns
// into a line in local memory, then along that line.
// Layout: row-major, pitch = width, readable 512 bytes past the end. FLOAT_IMAGE: float, else 8-bit,
// rounded to nearest. taps: radius + 1 of them, radius <= MAX_RADIUS.
// Launch: groups of MEMBERS x 1; x >= ceil(width / TILE) groups, y >= ceil(height / rows) groups.
// On a CPU a group is one work-item with vectors (LANES 16), on a GPU work-items with a pixel each.

#define MAX_RADIUS 40

#ifdef CORVID_PLANT_FAULT
#define ALONG(j) (taps[j] * ((j) == 1 ? 1.1f : 1.0f))
#else
#define ALONG(j) taps[j]
#endif

#ifdef FLOAT_IMAGE
typedef float pixel;
#else
typedef uchar pixel;
#endif

#if LANES == 16
typedef float16 vector;
typedef float16 vector_anywhere __attribute__((aligned(4)));
#define MEMBER 0
#define TOGETHER
#define LOAD_LINE(p) (*(__local const vector_anywhere*)(p))
#define STORE_LINE(v, p) *(__local vector_anywhere*)(p) = (v)
#ifdef FLOAT_IMAGE
#define LOAD(p) (*(__global const vector_anywhere*)(p))
#define PAIR(p, q) (LOAD(p) + LOAD(q))
#define TO_PIXELS(v) (v)
typedef float16 pixels_anywhere __attribute__((aligned(4)));
#else
#define LOAD(p) convert_float16(vload16(0, p))
#define PAIR(p, q) convert_float16(convert_int16(vload16(0, p)) + convert_int16(vload16(0, q)))
#define TO_PIXELS(v) convert_uchar16(convert_int16((v) + 0.5f))  // never negative
typedef uchar16 pixels_anywhere __attribute__((aligned(1)));
#endif
#else
typedef float vector;
#define MEMBER (int)get_local_id(0)
#define TOGETHER barrier(CLK_LOCAL_MEM_FENCE)
#define LOAD_LINE(p) (*(p))
#define LOAD(p) (float)(*(p))
#define PAIR(p, q) (LOAD(p) + LOAD(q))
#endif

// Sum down column x and, with vectors, those after it.
inline vector sum_column(__global const pixel* in, int width, int height, int x, int y,
                         __global const float* taps, int radius) {
  vector sum = taps[0] * LOAD(in + (size_t)y * width + x);
  for (int j = 1; j <= radius; ++j)
    sum += taps[j] * PAIR(in + (size_t)max(y - j, 0) * width + x,
                          in + (size_t)min(y + j, height - 1) * width + x);
  return sum;
}

__kernel void blur(__global const pixel* restrict in, int width, int height,
                   __global pixel* restrict out, __global const float* restrict taps, int radius,
                   int rows) {
  __local float line[TILE + 2 * MAX_RADIUS + 2 * LANES];  // columns from x0 - radius on
  const int x0 = get_group_id(0) * TILE, count = min(TILE, width - x0);
  const int first = get_group_id(1) * rows, end = min(first + rows, height);
  for (int y = first; y < end; ++y) {
#if LANES == 16
    const int from = max(-radius, -x0), to_end = min(count + radius, width - x0);
    for (int i = from; i < to_end; i += LANES)
      STORE_LINE(sum_column(in, width, height, x0 + i, y, taps, radius), line + radius + i);
    for (int i = -radius; i < from; ++i) line[radius + i] = line[radius + from];
    for (int i = to_end; i < count + radius; ++i) line[radius + i] = line[radius + to_end - 1];
#else
    for (int i = MEMBER - radius; i < count + radius; i += MEMBERS)
      line[radius + i] =
          sum_column(in, width, height, clamp(x0 + i, 0, width - 1), y, taps, radius);
#endif
    TOGETHER;
    __global pixel* to = out + (size_t)y * width + x0;
    for (int x = MEMBER * LANES; x < count; x += MEMBERS * LANES) {
      __local const float* centre = line + radius + x;
      vector sum = ALONG(0) * LOAD_LINE(centre);
      for (int j = 1; j <= radius; ++j)
        sum += ALONG(j) * (LOAD_LINE(centre - j) + LOAD_LINE(centre + j));
#if LANES == 16
      if (x + LANES <= count) {
        *(__global pixels_anywhere*)(to + x) = TO_PIXELS(sum);
      } else {
        pixel some[LANES];
        *(pixels_anywhere*)some = TO_PIXELS(sum);
        for (int i = 0; i < count - x; ++i) to[x + i] = some[i];
      }
#elif defined(FLOAT_IMAGE)
      to[x] = sum;
#else
      to[x] = convert_uchar(sum + 0.5f);
#endif
    }
    TOGETHER;
  }
}
