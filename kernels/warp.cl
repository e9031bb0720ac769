// Warps an image: out(x, y) = in(p(x, y)), bilinear, 0 where p leaves [0, in_width - 1] x
// [0, in_height - 1] or is no number. The place p is read from a map or is that of a homography.
// Layout: images row-major, pitch = width, readable 512 bytes past the end; FLOAT_IMAGE: float, else
// 8-bit, rounded to nearest. map: (x, y) pairs of float, row-major.
// Launch with LANES 16, for CPUs: x >= ceil(height / rows) items, each makes `rows` rows; with
// LANES 1, for GPUs: x >= width, y >= height, one pixel each.

#ifdef cl_khr_fp64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif

#ifdef CORVID_PLANT_FAULT
#define HALF_PIXEL 0.1f
#else
#define HALF_PIXEL 0.0f
#endif

#ifdef FLOAT_IMAGE
typedef float pixel;
#else
typedef uchar pixel;
#endif

#if LANES == 16
typedef float16 floats;
typedef int16 ints;
#define TO_INTS convert_int16
#define TO_FLOATS convert_float16
#define LANE (float16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
#define GATHER8(type, F, at)                                                                     \
  (type)(F((at).s0), F((at).s1), F((at).s2), F((at).s3), F((at).s4), F((at).s5), F((at).s6),     \
         F((at).s7))
#else
typedef float floats;
typedef int ints;
#define TO_INTS (int)
#define TO_FLOATS (float)
#define LANE 0.0f
#endif

typedef struct {
  __global const pixel* pixels;
  int width, height;
} Source;

// Two pixels of a row beside each other, `at` the left one. The right one may be past the image.
inline void read_pairs(__global const pixel* pixels, ints at, floats* left, floats* right) {
#if LANES == 1
  *left = pixels[at];
  *right = pixels[at + 1];
#elif defined(FLOAT_IMAGE)
  typedef ulong pair_anywhere __attribute__((aligned(4)));
#define BOTH(i) *(__global const pair_anywhere*)(pixels + (i))
  const float16 a = as_float16(GATHER8(ulong8, BOTH, at.lo));
  const float16 b = as_float16(GATHER8(ulong8, BOTH, at.hi));
  *left = (float16)(a.even, b.even);
  *right = (float16)(a.odd, b.odd);
#else
  typedef ushort pair_anywhere __attribute__((aligned(1)));
#define BOTH(i) *(__global const pair_anywhere*)(pixels + (i))
  const int16 both = convert_int16(
      (ushort16)(GATHER8(ushort8, BOTH, at.lo), GATHER8(ushort8, BOTH, at.hi)));
  *left = convert_float16(both & 0xff);
  *right = convert_float16(both >> 8);
#endif
}

// The source at (px, py).
inline floats sample(const Source* in, floats px, floats py) {
  px += HALF_PIXEL;
  py += HALF_PIXEL;
  const ints inside =
      px >= 0.0f && py >= 0.0f && px <= in->width - 1.0f && py <= in->height - 1.0f;
#if LANES == 1
  const ints x = inside ? (int)px : 0, y = inside ? (int)py : 0;
  const ints at = y * in->width + x, below = y < in->height - 1 ? at + in->width : at;
#else
  const ints none = 0;
  const ints x = select(none, TO_INTS(px), inside), y = select(none, TO_INTS(py), inside);
  const ints at = y * in->width + x, below = at + ((y < in->height - 1) & in->width);
#endif
  const floats fx = px - TO_FLOATS(x), fy = py - TO_FLOATS(y), zero = 0.0f;
  floats left, right, lower_left, lower_right;
  read_pairs(in->pixels, at, &left, &right);
  read_pairs(in->pixels, below, &lower_left, &lower_right);
#ifdef FLOAT_IMAGE
  // What is past the image may be no number.
  right = select(left, right, fx > zero);
  lower_right = select(lower_left, lower_right, fx > zero);
#endif
  const floats top = left + fx * (right - left);
  const floats bottom = lower_left + fx * (lower_right - lower_left);
  return select(zero, top + fy * (bottom - top), inside);
}

// Stores the first `count` lanes.
inline void store_pixels(__global pixel* to, floats value, int count) {
#if LANES == 1
#ifdef FLOAT_IMAGE
  *to = value;
#else
  *to = convert_uchar_sat_rte(value);
#endif
#else
#ifdef FLOAT_IMAGE
  typedef float16 pixels_anywhere __attribute__((aligned(4)));
  const float16 made = value;
#else
  typedef uchar16 pixels_anywhere __attribute__((aligned(1)));
  // 1.5 * 2^23 leaves no place for a fraction: the sum is rounded to nearest, in its low bits.
  const uchar16 made = convert_uchar16(as_uint16(value + 12582912.0f) & 0xff);
#endif
  if (count >= LANES) {
    *(__global pixels_anywhere*)to = made;
  } else {
    pixel some[LANES];
    *(pixels_anywhere*)some = made;
    for (int i = 0; i < count; ++i) to[i] = some[i];
  }
#endif
}

inline floats by_map(const Source* in, __global const float* map, int width, int x, int y) {
  __global const float* p = map + 2 * ((size_t)y * width + x);
#if LANES == 1
  return sample(in, p[0], p[1]);
#else
  typedef float16 floats_anywhere __attribute__((aligned(4)));
  // Of the last lanes only those inside the map are read.
  if (x + LANES <= width) {
    const float16 a = *(__global const floats_anywhere*)p;
    const float16 b = *(__global const floats_anywhere*)(p + LANES);
    return sample(in, (float16)(a.even, b.even), (float16)(a.odd, b.odd));
  }
  float px[LANES], py[LANES];
  for (int i = 0; i < LANES; ++i) {
    const int at = 2 * min(i, width - x - 1);
    px[i] = p[at];
    py[i] = p[at + 1];
  }
  return sample(in, *(floats_anywhere*)px, *(floats_anywhere*)py);
#endif
}

#ifdef cl_khr_fp64
// The homography h, row by row. In double precision at one lane, the one with the largest third
// coordinate; from there p(lane) - p(there) = (lane - there) (h_0 - p h_6) / z(lane) is exact and
// may be computed in single precision: it is small.
typedef struct {
  double h0, h1, h2, h3, h4, h5, h6, h7, h8;
} Homography;

inline floats by_homography(const Source* in, const Homography* h, int x, int y) {
  const int there = h->h6 > 0 ? LANES - 1 : 0;
  const double u = x + there, v = y;
  const double z = h->h6 * u + h->h7 * v + h->h8, inverse = 1 / z;
  const double px = (h->h0 * u + h->h1 * v + h->h2) * inverse;
  const double py = (h->h3 * u + h->h4 * v + h->h5) * inverse;
  const floats lane = LANE - (float)there;
  const floats depth = (float)z + lane * (float)h->h6, scale = lane / depth;
  const floats nowhere = -1.0f;
  const ints before = depth > 0.0f;
  return sample(in,
                select(nowhere, (float)px + scale * (float)(h->h0 - px * h->h6), before),
                select(nowhere, (float)py + scale * (float)(h->h3 - py * h->h6), before));
}

#endif

#if LANES == 16
#define EACH_VECTOR                                                                              \
  const int first = get_global_id(0) * rows, end = min(first + rows, height);                    \
  for (int y = first; y < end; ++y)                                                              \
    for (int x = 0; x < width; x += LANES)
#else
#define EACH_VECTOR                                                                              \
  const int x = get_global_id(0), y = get_global_id(1);                                          \
  if (x < width && y < height)
#endif

__kernel void remap(__global const pixel* restrict in, int in_width, int in_height,
                    __global pixel* restrict out, int width, int height, int rows,
                    __global const float* restrict map) {
  const Source source = {in, in_width, in_height};
  EACH_VECTOR {
    store_pixels(out + (size_t)y * width + x, by_map(&source, map, width, x, y), width - x);
  }
}

#ifdef cl_khr_fp64
__kernel void homography(__global const pixel* restrict in, int in_width, int in_height,
                         __global pixel* restrict out, int width, int height, int rows, double h0,
                         double h1, double h2, double h3, double h4, double h5, double h6,
                         double h7, double h8) {
  const Source source = {in, in_width, in_height};
  const Homography h = {h0, h1, h2, h3, h4, h5, h6, h7, h8};
  EACH_VECTOR {
    store_pixels(out + (size_t)y * width + x, by_homography(&source, &h, x, y), width - x);
  }
}
#endif
