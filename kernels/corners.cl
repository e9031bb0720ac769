// Corner scores (Shi-Tomasi and Harris-Stephens) and their maxima.
//   gradients  I_x = (I(x+1,y) - I(x-1,y)) / 2, I_y alike
//   tensor     a = G * I_x^2, b = G * I_x I_y, c = G * I_y^2; G: 7x7 Gaussian, sigma 1.5, sum 1
//   lambda_min = (a + c - sqrt((a - c)^2 + 4 b^2)) / 2
//   harris     = a c - b^2 - kappa (a + c)^2
// Layout: image 8-bit, row-major, pitch = width, readable 512 bytes past the end. Score planes have
// the pitch `pitch`, a multiple of 16, and 32 floats more at the end. Scores are 0 within REACH
// pixels of the border.
// LANES 16, for CPUs: score_bands and maxima with x >= ceil(height / rows) items, each makes `rows`
// rows. LANES 1, for GPUs: columns, scores and maxima with x >= pitch, y >= height, one pixel each.
// Launch of points: x >= number of points.

#define RADIUS 3
#define REACH 4  // RADIUS and one pixel for the gradient

#ifdef CORVID_PLANT_FAULT
#define CROSS 1.1f
#else
#define CROSS 1.0f
#endif

#define W0 0.27068216f
#define W1 0.21674532f
#define W2 0.11128076f
#define W3 0.036632847f
__constant float kWindow[7] = {W3, W2, W1, W0, W1, W2, W3};

#if LANES == 16

typedef float16 floats_anywhere __attribute__((aligned(4)));
#define LOAD(p) (*(const floats_anywhere*)(p))
#define STORE(v, p) *(floats_anywhere*)(p) = (v)
#define GREY(p) convert_int16(vload16(0, p))

// One side of the window and the other, from seven values of a plane `step` apart.
#define WINDOW(p, m3, m2, m1, m0, n1, n2, n3)                                                    \
  (W0 * LOAD(p + m0) + W1 * (LOAD(p + m1) + LOAD(p + n1)) + W2 * (LOAD(p + m2) + LOAD(p + n2)) +  \
   W3 * (LOAD(p + m3) + LOAD(p + n3)))

#define TILE 128  // columns whose rows below fit into the fastest cache
#define KEPT 8    // rows kept, a power of two > 2 * RADIUS

// state[0]: bits of the largest lambda_min; bits of non-negative floats are in the floats' order.
// Every row's products are summed along the row once and kept; each row of scores sums seven.
__kernel void score_bands(__global const uchar* restrict image, int width, int height, int pitch,
                          float kappa, __global float* restrict lambda_min,
                          __global float* restrict harris, __global volatile int* state,
                          int rows) {
  const int first = get_global_id(0) * rows, end = min(first + rows, height);
  const int from = max(first, REACH), to = min(end, height - REACH);
  for (int y = first; y < end; ++y)
    if (y < REACH || y >= height - REACH)
      for (int x = 0; x < pitch; x += LANES) {
        vstore16((float16)(0), 0, lambda_min + (size_t)y * pitch + x);
        vstore16((float16)(0), 0, harris + (size_t)y * pitch + x);
      }
  const int16 lane = (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  const float16 zero = 0;
  float16 most = 0;
  float line[3][TILE + 3 * LANES];  // products of one row from column x0 - LANES on
  float kept[3][KEPT * TILE];       // their sums along the rows
  for (int x0 = 0; x0 < pitch && from < to; x0 += TILE) {
    const int count = min(TILE, pitch - x0);
    if (x0 == 0)  // what is left of the image takes part in no score
      for (int i = 0; i < 3; ++i) STORE(zero, line[i]);
    for (int row = from - RADIUS; row < to + RADIUS; ++row) {
      __global const uchar* p = image + (size_t)row * width + x0;
      for (int x = x0 > 0 ? -LANES : 0; x < count + RADIUS; x += LANES) {
        // Twice the gradient.
        const float16 gx = convert_float16(GREY(p + x + 1) - GREY(p + x - 1));
        const float16 gy = convert_float16(GREY(p + x + width) - GREY(p + x - width));
        STORE(gx * gx, line[0] + LANES + x);
        STORE(CROSS * gx * gy, line[1] + LANES + x);
        STORE(gy * gy, line[2] + LANES + x);
      }
      for (int x = 0; x < count; x += LANES)
#pragma unroll
        for (int i = 0; i < 3; ++i) {
          const float* q = line[i] + LANES + x;
          STORE(0.25f * WINDOW(q, -3, -2, -1, 0, 1, 2, 3),
                kept[i] + (row & (KEPT - 1)) * TILE + x);
        }
      const int y = row - RADIUS;
      if (y < from) continue;
#define KEPT_ROW(j) (((y + (j)) & (KEPT - 1)) * TILE)
      const int m3 = KEPT_ROW(-3), m2 = KEPT_ROW(-2), m1 = KEPT_ROW(-1), m0 = KEPT_ROW(0),
                n1 = KEPT_ROW(1), n2 = KEPT_ROW(2), n3 = KEPT_ROW(3);
      for (int x = 0; x < count; x += LANES) {
        const float16 a = WINDOW(kept[0] + x, m3, m2, m1, m0, n1, n2, n3);
        const float16 b = WINDOW(kept[1] + x, m3, m2, m1, m0, n1, n2, n3);
        const float16 c = WINDOW(kept[2] + x, m3, m2, m1, m0, n1, n2, n3);
        const int16 column = x0 + x + lane;
        const int16 inside = column >= REACH && column < width - REACH;
        float16 l = 0.5f * (a + c - sqrt((a - c) * (a - c) + 4.0f * b * b));
        float16 h = a * c - b * b - kappa * (a + c) * (a + c);
        l = select(zero, l > zero ? l : zero, inside);
        h = select(zero, h, inside);
        most = l > most ? l : most;
        vstore16(l, 0, lambda_min + (size_t)y * pitch + x0 + x);
        vstore16(h, 0, harris + (size_t)y * pitch + x0 + x);
      }
    }
  }
  const float8 m8 = fmax(most.lo, most.hi);
  const float4 m4 = fmax(m8.lo, m8.hi);
  atomic_max(state, as_int(fmax(fmax(m4.x, m4.y), fmax(m4.z, m4.w))));
}

#else

// products: the planes a, b, c after the vertical half of G.
__kernel void columns(__global const uchar* restrict image, int width, int height, int pitch,
                      __global float* restrict products) {
  const int x = get_global_id(0);
  const int y = get_global_id(1);
  if (x >= width || y < REACH || y >= height - REACH) return;
  float a = 0.0f, b = 0.0f, c = 0.0f;
  for (int j = 0; j < 7; ++j) {
    __global const uchar* p = image + (size_t)(y + j - RADIUS) * width + x;
    const float gx = 0.5f * ((float)p[1] - (float)p[-1]);
    const float gy = 0.5f * ((float)p[width] - (float)p[-width]);
    a += kWindow[j] * gx * gx;
    b += kWindow[j] * gx * gy;
    c += kWindow[j] * gy * gy;
  }
  const size_t plane = (size_t)pitch * height;
  const size_t at = (size_t)y * pitch + x;
  products[at] = a;
  products[plane + at] = CROSS * b;
  products[2 * plane + at] = c;
}

// state[0]: bits of the largest lambda_min; bits of non-negative floats are in the floats' order.
__kernel void scores(__global const float* restrict products, int width, int height, int pitch,
                     float kappa, __global float* restrict lambda_min,
                     __global float* restrict harris, __global volatile int* state) {
  const int x = get_global_id(0);
  const int y = get_global_id(1);
  if (x >= pitch || y >= height) return;
  const size_t at = (size_t)y * pitch + x;
  float l = 0.0f, h = 0.0f;
  if (x >= REACH && x < width - REACH && y >= REACH && y < height - REACH) {
    const size_t plane = (size_t)pitch * height;
    __global const float* p = products + at - RADIUS;
    float a = 0.0f, b = 0.0f, c = 0.0f;
    for (int i = 0; i < 7; ++i) {
      a += kWindow[i] * p[i];
      b += kWindow[i] * p[plane + i];
      c += kWindow[i] * p[2 * plane + i];
    }
    l = fmax(0.5f * (a + c - sqrt((a - c) * (a - c) + 4.0f * b * b)), 0.0f);
    h = a * c - b * b - kappa * (a + c) * (a + c);
  }
  lambda_min[at] = l;
  harris[at] = h;
  if (as_int(l) > state[0]) atomic_max(state, as_int(l));
}

#endif

typedef struct {
  float x, y, lambda_min, harris;
} Corner;

// The corner at a maximum of lambda_min, at the vertex of the least-squares quadratic of the 3x3
// neighbourhood.
inline Corner corner_at(__global const float* lambda_min, __global const float* harris, int pitch,
                        int x, int y) {
  __global const float* s = lambda_min + (size_t)y * pitch + x;
  const float n0 = s[-pitch - 1], n1 = s[-pitch], n2 = s[-pitch + 1], n3 = s[-1], c = s[0],
              n4 = s[1], n5 = s[pitch - 1], n6 = s[pitch], n7 = s[pitch + 1];
  const float gx = (n2 + n4 + n7 - n0 - n3 - n5) / 6.0f;
  const float gy = (n5 + n6 + n7 - n0 - n1 - n2) / 6.0f;
  const float hxx = (n0 + n3 + n5 + n2 + n4 + n7 - 2.0f * (n1 + c + n6)) / 3.0f;
  const float hyy = (n0 + n1 + n2 + n5 + n6 + n7 - 2.0f * (n3 + c + n4)) / 3.0f;
  const float hxy = (n0 + n7 - n2 - n5) / 4.0f;
  const float det = hxx * hyy - hxy * hxy;
  float dx = (hxy * gy - hyy * gx) / det;
  float dy = (hxy * gx - hxx * gy) / det;
  if (!(hxx < 0.0f && det > 0.0f && fabs(dx) <= 1.0f && fabs(dy) <= 1.0f)) dx = dy = 0.0f;
  const Corner corner = {x + dx, y + dy, c, harris[(size_t)y * pitch + x]};
  return corner;
}

// Strict 3x3 maxima of lambda_min above quality * max with harris > 0, at least `border` (> REACH)
// from the border. state[1] counts them; their order is that of the counter.
__kernel void maxima(__global const float* restrict lambda_min, __global const float* restrict harris,
                     int width, int height, int pitch, float quality, int border,
                     __global Corner* corners, __global volatile int* state, int rows) {
  const float threshold = quality * as_float(state[0]);
#if LANES == 16
  const int16 lane = (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  const int first = max((int)get_global_id(0) * rows, border);
  const int end = min((int)get_global_id(0) * rows + rows, height - border);
  Corner found[64];  // given to `corners` many at a time: the counter is dear
  int count = 0;
  for (int y = first; y < end; ++y) {
    for (int x = 0; x < width; x += LANES) {
      __global const float* p = lambda_min + (size_t)y * pitch + x;
      const float16 centre = vload16(0, p);
#define ABOVE(i) (centre > vload16(0, p + (i)))
      const int16 column = x + lane;
      const int16 is = centre > threshold && column >= border && column < width - border &&
                       ABOVE(-1) && ABOVE(1) && ABOVE(-pitch) && ABOVE(pitch) &&
                       ABOVE(-pitch - 1) && ABOVE(-pitch + 1) && ABOVE(pitch - 1) &&
                       ABOVE(pitch + 1) && vload16(0, harris + (size_t)y * pitch + x) > 0.0f;
      const int16 bits16 = is & ((int16)(1) << lane);
      const int8 bits8 = bits16.lo | bits16.hi;
      const int4 bits4 = bits8.lo | bits8.hi;
      uint bits = bits4.x | bits4.y | bits4.z | bits4.w;
      for (; bits != 0; bits &= bits - 1)
        found[count++] =
            corner_at(lambda_min, harris, pitch, x + 31 - clz((int)(bits & -bits)), y);
      const int last = y == end - 1 && x + LANES >= width;
      if (count > 0 && (last || count > 64 - LANES)) {
        const int at = atomic_add(state + 1, count);
        for (int i = 0; i < count; ++i) corners[at + i] = found[i];
        count = 0;
      }
    }
  }
#else
  const int x = get_global_id(0);
  const int y = get_global_id(1);
  if (x < border || x >= width - border || y < border || y >= height - border) return;
  __global const float* s = lambda_min + (size_t)y * pitch + x;
  const float c = s[0];
  if (c > threshold && harris[(size_t)y * pitch + x] > 0.0f && c > s[-1] && c > s[1] &&
      c > s[-pitch - 1] && c > s[-pitch] && c > s[-pitch + 1] && c > s[pitch - 1] &&
      c > s[pitch] && c > s[pitch + 1])
    corners[atomic_inc(state + 1)] = corner_at(lambda_min, harris, pitch, x, y);
#endif
}

// Both scores at the pixels nearest to the points (x, y).
__kernel void points(__global const uchar* restrict image, int width, int height, float kappa,
                     __global const float* restrict asked, int count,
                     __global float* restrict answered) {
  const int index = get_global_id(0);
  if (index >= count) return;
  const float px = asked[2 * index], py = asked[2 * index + 1];
  float a = 0.0f, b = 0.0f, c = 0.0f;
  // Also false for NaN.
  if (px > REACH - 0.5f && px < width - REACH - 0.5f && py > REACH - 0.5f &&
      py < height - REACH - 0.5f) {
    const int x = (int)floor(px + 0.5f), y = (int)floor(py + 0.5f);
    for (int i = -RADIUS; i <= RADIUS; ++i) {
      float ca = 0.0f, cb = 0.0f, cc = 0.0f;
      for (int j = -RADIUS; j <= RADIUS; ++j) {
        __global const uchar* p = image + (size_t)(y + j) * width + x + i;
        const float gx = 0.5f * ((float)p[1] - (float)p[-1]);
        const float gy = 0.5f * ((float)p[width] - (float)p[-width]);
        ca += kWindow[j + RADIUS] * gx * gx;
        cb += kWindow[j + RADIUS] * gx * gy;
        cc += kWindow[j + RADIUS] * gy * gy;
      }
      a += kWindow[i + RADIUS] * ca;
      b += kWindow[i + RADIUS] * CROSS * cb;
      c += kWindow[i + RADIUS] * cc;
    }
  }
  answered[2 * index] = fmax(0.5f * (a + c - sqrt((a - c) * (a - c) + 4.0f * b * b)), 0.0f);
  answered[2 * index + 1] = a * c - b * b - kappa * (a + c) * (a + c);
}
