// Halves an image: out(x, y) = sum_ij b_i b_j in(2x + i, 2y + j), b = [1 4 6 4 1] / 16, i, j = -2..2,
// border pixels repeated. 8-bit images are summed exactly in integers and rounded to nearest.
// Layout: row-major, pitch = width, readable 512 bytes past the end. FLOAT_IMAGE: float, else 8-bit.
// Two kernels for the same answer:
//   halve_bands   for CPUs: x >= ceil(out_height / rows) items, each makes `rows` rows in turn
//   halve_pixels  for GPUs: x >= out_width, y >= out_height, one pixel each

#ifdef CORVID_PLANT_FAULT
#define CENTRE 7
#else
#define CENTRE 6
#endif
#define BINOMIAL(a, b, c, d, e) ((a) + (e) + (((b) + (d)) * 4) + (c)*CENTRE)

// VECTOR holds LANES sums in FIELDS: of 8-bit images two 16-bit fields in each 32-bit element, which
// makes even and odd columns a mask apart. No field overflows: 16 * 16 * 255 + 128 < 2^16.
#ifdef FLOAT_IMAGE
typedef float pixel;
typedef float field;
typedef float16 vector;
typedef float16 anywhere __attribute__((aligned(4)));
#define LANES 16
#define FIRST(v) (v)
#define ROUNDED(sum) ((sum) / 256.0f)
#else
typedef uchar pixel;
typedef uint field;
typedef uint16 vector;
typedef uint16 anywhere __attribute__((aligned(1)));
typedef uchar16 bytes_anywhere __attribute__((aligned(1)));
#define LANES 32
#define ROUNDED(sum) (((sum) + 128) >> 8)
#endif

typedef struct {
  vector even, odd;  // of columns 2x and 2x + 1 for LANES columns x of the output
} Columns;

// Of float images the first and the second half of the columns, to be parted after the sum.
inline Columns load_columns(__global const pixel* p) {
  Columns c;
#ifdef FLOAT_IMAGE
  c.even = *(__global const anywhere*)p;
  c.odd = *(__global const anywhere*)(p + 16);
#else
  const uint16 four = *(__global const anywhere*)p;
  c.even = four & 0x00ff00ffu;
  c.odd = (four >> 8) & 0x00ff00ffu;
#endif
  return c;
}

// The five rows that make one row of the output.
typedef struct {
  __global const pixel* row[5];
  int width;
  field last;  // column width - 1
} Rows;

// Sums over the rows, border columns repeated; x: first column of the output.
inline Columns sum_rows(const Rows* r, int x) {
  const Columns a = load_columns(r->row[0] + 2 * x), b = load_columns(r->row[1] + 2 * x),
                c = load_columns(r->row[2] + 2 * x), d = load_columns(r->row[3] + 2 * x),
                e = load_columns(r->row[4] + 2 * x);
  Columns sum;
  sum.even = BINOMIAL(a.even, b.even, c.even, d.even, e.even);
  sum.odd = BINOMIAL(a.odd, b.odd, c.odd, d.odd, e.odd);
#ifdef FLOAT_IMAGE
  const Columns halves = sum;
  sum.even = (float16)(halves.even.even, halves.odd.even);
  sum.odd = (float16)(halves.even.odd, halves.odd.odd);
#endif
  if (2 * (x + LANES) > r->width) {
    const int16 lane = (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const int evens = (r->width + 1) / 2 - x, odds = r->width / 2 - x;
#ifdef FLOAT_IMAGE
    sum.even = select(sum.even, (float16)(r->last), lane >= evens);
    sum.odd = select(sum.odd, (float16)(r->last), lane >= odds);
#else
    const uint16 low = 0xffffu, high = 0xffff0000u, last = r->last * 0x10001u;
    const uint16 past_even = (as_uint16(2 * lane >= evens) & low) |
                             (as_uint16(2 * lane + 1 >= evens) & high);
    const uint16 past_odd = (as_uint16(2 * lane >= odds) & low) |
                            (as_uint16(2 * lane + 1 >= odds) & high);
    sum.even = (sum.even & ~past_even) | (last & past_even);
    sum.odd = (sum.odd & ~past_odd) | (last & past_odd);
#endif
  }
  return sum;
}

// Fields moved by one: the one before the first is the last of `before`, and so on.
inline vector from_left(vector v, field before) {
  const vector s = (vector)(before, v.s0, v.s1234, v.s5678, v.s9abc, v.sde);
#ifdef FLOAT_IMAGE
  return s;
#else
  return (v << 16) | (s >> 16);
#endif
}
inline vector from_right(vector v, field after) {
  const vector s = (vector)(v.s123, v.s4567, v.s89ab, v.scdef, after);
#ifdef FLOAT_IMAGE
  return s;
#else
  return (v >> 16) | (s << 16);
#endif
}

__kernel void halve_bands(__global const pixel* restrict in, int width, int height,
                          __global pixel* restrict out, int out_width, int out_height, int rows) {
  const int first = get_global_id(0) * rows, end = min(first + rows, out_height);
  for (int y = first; y < end; ++y) {
    Rows r;
    r.width = width;
    for (int j = 0; j < 5; ++j)
      r.row[j] = in + (size_t)clamp(2 * y + j - 2, 0, height - 1) * width;
#define AT(x) \
  BINOMIAL((field)r.row[0][x], (field)r.row[1][x], (field)r.row[2][x], (field)r.row[3][x], \
           (field)r.row[4][x])
    r.last = AT(width - 1);
    field even = AT(0), odd = even;
#ifndef FLOAT_IMAGE
    even <<= 16, odd <<= 16;
#endif
    Columns here = sum_rows(&r, 0);
    for (int x = 0; x < out_width; x += LANES) {
      Columns next;
      next.even = r.last;
      if (x + LANES < out_width) next = sum_rows(&r, x + LANES);
      const vector sum = BINOMIAL(from_left(here.even, even), from_left(here.odd, odd), here.even,
                                  here.odd, from_right(here.even, next.even.s0));
      even = here.even.sf;
      odd = here.odd.sf;
      here = next;
      // What is stored past a row's end is overwritten by the next row, if that is this item's.
      __global pixel* to = out + (size_t)y * out_width + x;
      const bool whole = (size_t)y * out_width + x + LANES <= (size_t)end * out_width;
#ifdef FLOAT_IMAGE
      const float16 made = ROUNDED(sum);
      if (whole) {
        *(__global anywhere*)to = made;
      } else {
        float some[LANES];
        *(anywhere*)some = made;
        for (int i = 0; i < out_width - x; ++i) to[i] = some[i];
      }
#else
      const uint16 made = ROUNDED(sum + (128 << 16)) & 0x00ff00ffu;
      const uchar16 low = convert_uchar16(as_ushort16(made.lo));
      const uchar16 high = convert_uchar16(as_ushort16(made.hi));
      if (whole) {
        *(__global bytes_anywhere*)to = low;
        *(__global bytes_anywhere*)(to + 16) = high;
      } else {
        uchar some[LANES];
        *(bytes_anywhere*)some = low;
        *(bytes_anywhere*)(some + 16) = high;
        for (int i = 0; i < out_width - x; ++i) to[i] = some[i];
      }
#endif
    }
  }
}

__kernel void halve_pixels(__global const pixel* restrict in, int width, int height,
                           __global pixel* restrict out, int out_width, int out_height) {
  const int x = get_global_id(0);
  const int y = get_global_id(1);
  if (x >= out_width || y >= out_height) return;
  field sum[5];
  for (int j = 0; j < 5; ++j) {
    __global const pixel* p = in + (size_t)clamp(2 * y + j - 2, 0, height - 1) * width;
#define COLUMN(i) (field)p[clamp(2 * x + i, 0, width - 1)]
    sum[j] = BINOMIAL(COLUMN(-2), COLUMN(-1), COLUMN(0), COLUMN(1), COLUMN(2));
  }
  out[(size_t)y * out_width + x] =
      (pixel)ROUNDED(BINOMIAL(sum[0], sum[1], sum[2], sum[3], sum[4]));
}
