// Corner scores (Shi-Tomasi and Harris-Stephens) and their maxima.
//   gradients  I_x = (I(x+1,y) - I(x-1,y)) / 2, I_y alike
//   tensor     a = G * I_x^2, b = G * I_x I_y, c = G * I_y^2; G: 7x7 Gaussian, sigma 1.5, sum 1
//   lambda_min = (a + c - sqrt((a - c)^2 + 4 b^2)) / 2
//   harris     = a c - b^2 - kappa (a + c)^2
// Layout: image 8-bit, row-major, pitch = width, readable 64 bytes past the end. Float planes have
// the pitch `pitch`, a multiple of 16; products holds the planes a, b, c after the vertical half of
// G. Scores are 0 within REACH pixels of the border.
// Launch of columns, scores and maxima: x >= pitch / 16, y >= height; 16 pixels of a row each.
// Launch of points: x >= number of points.

#define RADIUS 3
#define REACH 4  // RADIUS and one pixel for the gradient

#ifdef CORVID_PLANT_FAULT
#define CROSS 1.1f
#else
#define CROSS 1.0f
#endif

__constant float kWindow[7] = {0.036632847f, 0.11128076f, 0.21674532f, 0.27068216f,
                               0.21674532f,  0.11128076f, 0.036632847f};

inline float16 load(__global const uchar* p) { return convert_float16(vload16(0, p)); }

__kernel void columns(__global const uchar* restrict image, int width, int height, int pitch,
                      __global float* restrict products) {
  const int x = get_global_id(0) * 16;
  const int y = get_global_id(1);
  if (x >= pitch || y < REACH || y >= height - REACH) return;
  float16 a = 0, b = 0, c = 0;
  for (int j = 0; j < 7; ++j) {
    __global const uchar* p = image + (size_t)(y + j - RADIUS) * width + x;
    const float16 gx = 0.5f * (load(p + 1) - load(p - 1));
    const float16 gy = 0.5f * (load(p + width) - load(p - width));
    a += kWindow[j] * gx * gx;
    b += kWindow[j] * gx * gy;
    c += kWindow[j] * gy * gy;
  }
  const size_t plane = (size_t)pitch * height;
  const size_t at = (size_t)y * pitch + x;
  vstore16(a, 0, products + at);
  vstore16(CROSS * b, 0, products + plane + at);
  vstore16(c, 0, products + 2 * plane + at);
}

// state[0]: bits of the largest lambda_min; bits of non-negative floats are in the floats' order.
__kernel void scores(__global const float* restrict products, int width, int height, int pitch,
                     float kappa, __global float* restrict lambda_min,
                     __global float* restrict harris, __global volatile int* state) {
  const int x = get_global_id(0) * 16;
  const int y = get_global_id(1);
  if (x >= pitch || y >= height) return;
  const size_t at = (size_t)y * pitch + x;
  if (y < REACH || y >= height - REACH) {
    vstore16((float16)(0), 0, lambda_min + at);
    vstore16((float16)(0), 0, harris + at);
    return;
  }
  const size_t plane = (size_t)pitch * height;
  __global const float* p = products + at - RADIUS;
  float16 a = 0, b = 0, c = 0;
  for (int i = 0; i < 7; ++i) {
    a += kWindow[i] * vload16(0, p + i);
    b += kWindow[i] * vload16(0, p + plane + i);
    c += kWindow[i] * vload16(0, p + 2 * plane + i);
  }
  const int16 column = x + (int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  const int16 inside = column >= REACH && column < width - REACH;
  const float16 zero = 0;
  float16 l = 0.5f * (a + c - sqrt((a - c) * (a - c) + 4.0f * b * b));
  float16 h = a * c - b * b - kappa * (a + c) * (a + c);
  l = select(zero, fmax(l, zero), inside);
  h = select(zero, h, inside);
  vstore16(l, 0, lambda_min + at);
  vstore16(h, 0, harris + at);
  const float8 m8 = fmax(l.lo, l.hi);
  const float4 m4 = fmax(m8.lo, m8.hi);
  const int most = as_int(fmax(fmax(m4.x, m4.y), fmax(m4.z, m4.w)));
  if (most > state[0]) atomic_max(state, most);
}

typedef struct {
  float x, y, lambda_min, harris;
} Corner;

// Strict 3x3 maxima of lambda_min above quality * max with harris > 0, at least `border` (> REACH)
// from the border, with the vertex of the least-squares quadratic of the 3x3 neighbourhood.
// state[1] counts them; their order is that of the counter.
__kernel void maxima(__global const float* restrict lambda_min, __global const float* restrict harris,
                     int width, int height, int pitch, float quality, int border,
                     __global Corner* corners, __global volatile int* state) {
  const int x0 = get_global_id(0) * 16;
  const int y = get_global_id(1);
  if (x0 >= width || y < border || y >= height - border) return;
  const float threshold = quality * as_float(state[0]);
  __global const float* p = lambda_min + (size_t)y * pitch + x0;
  const float16 centre = vload16(0, p);
  if (!any(centre > threshold)) return;
  const float16 around = fmax(fmax(fmax(vload16(0, p - 1), vload16(0, p + 1)),
                                   fmax(vload16(0, p - pitch), vload16(0, p + pitch))),
                              fmax(fmax(vload16(0, p - pitch - 1), vload16(0, p - pitch + 1)),
                                   fmax(vload16(0, p + pitch - 1), vload16(0, p + pitch + 1))));
  if (!any(centre > threshold && centre > around)) return;
  for (int x = max(x0, border); x < min(x0 + 16, width - border); ++x) {
    __global const float* s = lambda_min + (size_t)y * pitch + x;
    const float h = harris[(size_t)y * pitch + x];
    const float n0 = s[-pitch - 1], n1 = s[-pitch], n2 = s[-pitch + 1], n3 = s[-1], c = s[0],
                n4 = s[1], n5 = s[pitch - 1], n6 = s[pitch], n7 = s[pitch + 1];
    if (!(c > threshold && h > 0.0f && c > n0 && c > n1 && c > n2 && c > n3 && c > n4 && c > n5 &&
          c > n6 && c > n7))
      continue;
    const float gx = (n2 + n4 + n7 - n0 - n3 - n5) / 6.0f;
    const float gy = (n5 + n6 + n7 - n0 - n1 - n2) / 6.0f;
    const float hxx = (n0 + n3 + n5 + n2 + n4 + n7 - 2.0f * (n1 + c + n6)) / 3.0f;
    const float hyy = (n0 + n1 + n2 + n5 + n6 + n7 - 2.0f * (n3 + c + n4)) / 3.0f;
    const float hxy = (n0 + n7 - n2 - n5) / 4.0f;
    const float det = hxx * hyy - hxy * hxy;
    float dx = (hxy * gy - hyy * gx) / det;
    float dy = (hxy * gx - hxx * gy) / det;
    if (!(hxx < 0.0f && det > 0.0f && fabs(dx) <= 1.0f && fabs(dy) <= 1.0f)) dx = dy = 0.0f;
    const Corner corner = {x + dx, y + dy, c, h};
    corners[atomic_inc(state + 1)] = corner;
  }
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
