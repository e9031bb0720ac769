// Normalized cross-correlation of templates of one image with windows of another, and its peaks.
//   C(x) = (s3 - s2 s4) / sqrt((s1 - s2^2) (s5 - s4^2)),   w: weights of sum 1
//   s1 = sum w t^2, s2 = sum w t, s3 = sum w S t, s4 = sum w S, s5 = sum w S^2
// The template is stored as t' = w (t - s2) / sqrt(s1 - s2^2), whose sum is zero but for rounding,
// so that C = (sum t' S - (sum t') s4) / sqrt(s5 - s4^2): one inner product per candidate. s4 and s5
// are sums over columns (kept up from row to row) of sums over rows; exact in integers for uniform
// weights.
// Layout: images 8-bit, row-major, pitch = width, readable 64 bytes past the end. Coefficients of a
// job: rows of `pitch` floats (a multiple of LANES) from `scores` on; NO_SCORE where there is none.
// A template is T rows of TEMPLATE_PITCH floats, zero past T.
// Options: T template side (odd); WEIGHTS the T comma-separated 1-d weights, sum 1 (w is their
// product); GAUSSIAN if they are not uniform; LANES candidates per vector; ROWS candidate rows per
// register tile; TILE_ROWS candidate rows per tile, a multiple of ROWS.
// Launch, one-dimensional: small: x >= jobs (template, tiles and peaks of a job in one work-item);
// or templates: x >= jobs, tiles: x >= tiles, peaks: x >= jobs.

#define HALF_T (T / 2)
#define AREA (T * T)
#define PATCH_ROWS (TILE_ROWS + T - 1)
#define PATCH_PITCH (((LANES + T - 1 + LANES - 1) / LANES) * LANES)
#define TEMPLATE_PITCH (((T + LANES - 1) / LANES) * LANES)
#define TEMPLATE_SIZE (T * TEMPLATE_PITCH)
#define TEMPLATE_FLOATS (TEMPLATE_SIZE + 1)  // and its sum, NAN if it has no variance
#define NO_SCORE -2.0f
#define MIN_TEMPLATE_VARIANCE 0.01f
#define MIN_GAUSSIAN_VARIANCE 0.1f
#define MAX_PEAKS 4

#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define floatv JOIN(float, LANES)
#define intv JOIN(int, LANES)
#define ulongv JOIN(ulong, LANES)
#define uintv JOIN(uint, LANES)
#define VLOAD(p) JOIN(vload, LANES)(0, p)
#define VSTORE(v, p) JOIN(vstore, LANES)(v, 0, p)
#define TO_FLOAT(v) JOIN(convert_float, LANES)(v)
#define TO_INT(v) JOIN(convert_int, LANES)(v)
#define TO_UINT(v) JOIN(convert_uint, LANES)(v)
#define TO_ULONG(v) JOIN(convert_ulong, LANES)(v)
#if LANES == 16
#define LANE_INDEX ((int16)(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15))
#else
#define LANE_INDEX ((int4)(0, 1, 2, 3))
#endif

inline float sum_lanes4(float4 v) { return (v.x + v.y) + (v.z + v.w); }
inline float sum_lanes16(float16 v) { return sum_lanes4((v.s0123 + v.s4567) + (v.s89ab + v.scdef)); }
#define SUM_LANES(v) JOIN(sum_lanes, LANES)(v)

typedef struct {
  int reference_x, reference_y;
  float fraction_x, fraction_y;
  float warp[4];
  int x, y, width, height;
  int flat;
  int scores, pitch;
} Job;

typedef struct {
  float x, y, score, cxx, cxy, cyy;
} Peak;

typedef struct {
  int count;
  Peak peaks[MAX_PEAKS];
  float best_raw;
} Result;

__constant float kWeights[TEMPLATE_PITCH] = {WEIGHTS};

// Catmull-Rom weights of the samples at -1, 0, 1, 2 for the place f in [0, 1).
#define CUBIC0(f) (0.5f * (f) * (-1.0f + (f) * (2.0f - (f))))
#define CUBIC1(f) (0.5f * (2.0f + (f) * (f) * (-5.0f + 3.0f * (f))))
#define CUBIC2(f) (0.5f * (f) * (1.0f + (f) * (4.0f - 3.0f * (f))))
#define CUBIC3(f) (0.5f * (f) * (f) * ((f) - 1.0f))
inline float4 cubic_weights(float f) {
  return (float4)(CUBIC0(f), CUBIC1(f), CUBIC2(f), CUBIC3(f));
}

// Four pixels of a row from x on, as the bytes of a word; pixels are repeated past the border.
inline uint read4(__global const uchar* image, int width, int height, int x, int y) {
  __global const uchar* row = image + clamp(y, 0, height - 1) * width;
  if (x >= 0 && x + 3 < width) return as_uint(vload4(0, row + x));
  const int last = width - 1;
  return as_uint((uchar4)(row[clamp(x, 0, last)], row[clamp(x + 1, 0, last)],
                          row[clamp(x + 2, 0, last)], row[clamp(x + 3, 0, last)]));
}

// t' of a job. Returns its sum, or NAN if there is no variance.
inline float make_template(__global const uchar* reference, int width, int height,
                           __global const Job* job, float* t) {
  const float a00 = job->warp[0], a01 = job->warp[1], a10 = job->warp[2], a11 = job->warp[3];
  floatv sums = 0;
  for (int v = 0; v < T; ++v) {
    for (int c = 0; c < TEMPLATE_PITCH; c += LANES) {
      // Lanes past the template repeat its last sample, with weight 0.
      const floatv du = TO_FLOAT(min(LANE_INDEX + (c - HALF_T), (intv)(HALF_T)));
      const float dv = (float)(v - HALF_T);
      const floatv px = job->fraction_x + a00 * du + a01 * dv;
      const floatv py = job->fraction_y + a10 * du + a11 * dv;
      const floatv whole_x = floor(px), whole_y = floor(py);
      const floatv fx = px - whole_x, fy = py - whole_y;
      int left[LANES], top[LANES];
      uint words[4][LANES];
      VSTORE(TO_INT(whole_x) + (job->reference_x - 1), left);
      VSTORE(TO_INT(whole_y) + (job->reference_y - 1), top);
      for (int k = 0; k < LANES; ++k)
        for (int j = 0; j < 4; ++j)
          words[j][k] = read4(reference, width, height, left[k], top[k] + j);
      const floatv cx[4] = {CUBIC0(fx), CUBIC1(fx), CUBIC2(fx), CUBIC3(fx)};
      const floatv cy[4] = {CUBIC0(fy), CUBIC1(fy), CUBIC2(fy), CUBIC3(fy)};
      floatv value = 0;
#pragma unroll
      for (int j = 0; j < 4; ++j) {
        const uintv word = VLOAD(words[j]);
        floatv along = 0;
#pragma unroll
        for (uint i = 0; i < 4; ++i) along += cx[i] * TO_FLOAT((word >> (8 * i)) & 255U);
        value += cy[j] * along;
      }
      sums += kWeights[v] * VLOAD(kWeights + c) * value;
      VSTORE(value, t + v * TEMPLATE_PITCH + c);
    }
  }
  const float mean = SUM_LANES(sums);
  floatv variances = 0;
  for (int v = 0; v < T; ++v)
    for (int c = 0; c < TEMPLATE_PITCH; c += LANES) {
      const floatv d = VLOAD(t + v * TEMPLATE_PITCH + c) - mean;
      const floatv wd = kWeights[v] * VLOAD(kWeights + c) * d;
      variances += wd * d;
      VSTORE(wd, t + v * TEMPLATE_PITCH + c);
    }
  const float variance = SUM_LANES(variances);
  if (!(variance >= MIN_TEMPLATE_VARIANCE)) return NAN;
  const float scale = 1.0f / sqrt(variance);
  sums = 0;
  for (int i = 0; i < TEMPLATE_SIZE; i += LANES) {
    const floatv scaled = scale * VLOAD(t + i);
    sums += scaled;
    VSTORE(scaled, t + i);
  }
#ifdef CORVID_PLANT_FAULT
  t[HALF_T * TEMPLATE_PITCH + HALF_T + 1] = 0.0f;
#endif
  return SUM_LANES(sums);
}

// Coefficients of `rows` <= TILE_ROWS rows of LANES candidates, the first centred at (x, y).
// Candidates from x_end on get NO_SCORE.
inline void score_tile(__global const uchar* target, int target_width, const float* t, float t_sum,
                       int x, int y, int x_end, int rows, __global float* out, int out_pitch) {
  float patch[PATCH_ROWS * PATCH_PITCH];
  __global const uchar* source = target + (y - HALF_T) * target_width + x - HALF_T;
  for (int r = 0; r < PATCH_ROWS; ++r)
    for (int c = 0; c < PATCH_PITCH; c += LANES)
      VSTORE(r < rows + T - 1 ? TO_FLOAT(VLOAD(source + r * target_width + c)) : (floatv)(0),
             patch + r * PATCH_PITCH + c);

#ifdef GAUSSIAN
  const float origin = patch[HALF_T * PATCH_PITCH + HALF_T];  // keeps the sums of squares small
  for (int i = 0; i < PATCH_ROWS * PATCH_PITCH; i += LANES)
    VSTORE(VLOAD(patch + i) - origin, patch + i);
  float columns4[PATCH_PITCH], columns5[PATCH_PITCH];
#else
  int columns4[PATCH_PITCH], columns5[PATCH_PITCH];
  for (int c = 0; c < PATCH_PITCH; c += LANES) {
    intv sum4 = 0, sum5 = 0;
    for (int r = 0; r < T - 1; ++r) {
      const intv s = TO_INT(VLOAD(patch + r * PATCH_PITCH + c));
      sum4 += s;
      sum5 += s * s;
    }
    VSTORE(sum4, columns4 + c);
    VSTORE(sum5, columns5 + c);
  }
#endif

  for (int first = 0; first < rows; first += ROWS) {
    floatv s3[ROWS];
    for (int j = 0; j < ROWS; ++j) s3[j] = 0;
    for (int v = 0; v < T; ++v) {
      const float* row = patch + (first + v) * PATCH_PITCH;
#pragma unroll
      for (int u = 0; u < T; ++u) {
        const float tvu = t[v * TEMPLATE_PITCH + u];
#pragma unroll
        for (int j = 0; j < ROWS; ++j) s3[j] += tvu * VLOAD(row + j * PATCH_PITCH + u);
      }
    }
#pragma unroll
    for (int j = 0; j < ROWS; ++j) {
      const int r = first + j;
      if (r >= rows) break;
      const float* row = patch + r * PATCH_PITCH;
#ifdef GAUSSIAN
      for (int c = 0; c < PATCH_PITCH; c += LANES) {
        floatv sum4 = 0, sum5 = 0;
        for (int v = 0; v < T; ++v) {
          const floatv s = VLOAD(row + v * PATCH_PITCH + c);
          sum4 += kWeights[v] * s;
          sum5 += kWeights[v] * s * s;
        }
        VSTORE(sum4, columns4 + c);
        VSTORE(sum5, columns5 + c);
      }
      floatv s4 = 0, s5 = 0;
      for (int u = 0; u < T; ++u) {
        s4 += kWeights[u] * VLOAD(columns4 + u);
        s5 += kWeights[u] * VLOAD(columns5 + u);
      }
      const floatv variance = s5 - s4 * s4;
      const intv scored = variance >= MIN_GAUSSIAN_VARIANCE;
#else
      for (int c = 0; c < PATCH_PITCH; c += LANES) {
        const intv s = TO_INT(VLOAD(row + (T - 1) * PATCH_PITCH + c));
        VSTORE(VLOAD(columns4 + c) + s, columns4 + c);
        VSTORE(VLOAD(columns5 + c) + s * s, columns5 + c);
      }
      intv sum4 = 0, sum5 = 0;
      for (int u = 0; u < T; ++u) {
        sum4 += VLOAD(columns4 + u);
        sum5 += VLOAD(columns5 + u);
      }
      for (int c = 0; c < PATCH_PITCH; c += LANES) {
        const intv s = TO_INT(VLOAD(row + c));
        VSTORE(VLOAD(columns4 + c) - s, columns4 + c);
        VSTORE(VLOAD(columns5 + c) - s * s, columns5 + c);
      }
      const floatv s4 = TO_FLOAT(sum4) / (float)AREA;
#if AREA * AREA * 255 * 255 / 65536 < 65536
      const floatv n2_variance =
          TO_FLOAT((uint)AREA * TO_UINT(sum5) - TO_UINT(sum4) * TO_UINT(sum4));
#else
      const floatv n2_variance =
          TO_FLOAT((ulong)AREA * TO_ULONG(sum5) - TO_ULONG(sum4) * TO_ULONG(sum4));
#endif
      const floatv variance = n2_variance / ((float)AREA * AREA);
      const intv scored = n2_variance > 0.0f;
#endif
      const floatv c = clamp((s3[j] - t_sum * s4) / sqrt(variance), -1.0f, 1.0f);
      VSTORE(select((floatv)(NO_SCORE), c, scored && x + LANE_INDEX < x_end), out + r * out_pitch);
    }
  }
}

inline void clear(__global Result* result) {
  result->count = 0;
  result->best_raw = NO_SCORE;
  for (int i = 0; i < MAX_PEAKS; ++i) {
    const Peak none = {0.0f, 0.0f, 0.0f, 0.0f, 0.0f, 0.0f};
    result->peaks[i] = none;
  }
}

// Parabola through three values, c the largest.
inline Peak refine_1d(float before, float c, float after) {
  const float curvature = before + after - 2.0f * c;  // negative
  const float slope = 0.5f * (after - before);
  const float d = -slope / curvature;  // |d| <= 1/2
  const Peak peak = {d, 0.0f, min(c + 0.5f * slope * d, 1.0f), curvature, 0.0f, 0.0f};
  return peak;
}

// Vertex of the least-squares quadratic c0 + g.d + d'Hd/2 of a 3x3 neighbourhood; where it has no
// vertex within a pixel, the pixel itself with the curvatures along the axes.
inline Peak refine_2d(__global const float* s, int pitch) {
  const float n0 = s[-pitch - 1], n1 = s[-pitch], n2 = s[-pitch + 1], n3 = s[-1], c = s[0],
              n4 = s[1], n5 = s[pitch - 1], n6 = s[pitch], n7 = s[pitch + 1];
  const float gx = (n2 + n4 + n7 - n0 - n3 - n5) / 6.0f;
  const float gy = (n5 + n6 + n7 - n0 - n1 - n2) / 6.0f;
  const float hxx = (n0 + n3 + n5 + n2 + n4 + n7 - 2.0f * (n1 + c + n6)) / 3.0f;
  const float hyy = (n0 + n1 + n2 + n5 + n6 + n7 - 2.0f * (n3 + c + n4)) / 3.0f;
  const float hxy = (n0 + n7 - n2 - n5) / 4.0f;
  const float det = hxx * hyy - hxy * hxy;
  const float dx = (hxy * gy - hyy * gx) / det;
  const float dy = (hxy * gx - hxx * gy) / det;
  if (hxx < 0.0f && det > 0.0f && fabs(dx) <= 1.0f && fabs(dy) <= 1.0f) {
    const float c0 = (5.0f * c + 2.0f * (n1 + n3 + n4 + n6) - (n0 + n2 + n5 + n7)) / 9.0f;
    const Peak peak = {dx, dy, clamp(c0 + 0.5f * (gx * dx + gy * dy), -1.0f, 1.0f), hxx, hxy, hyy};
    return peak;
  }
  const Peak peak = {0.0f, 0.0f, c, n3 + n4 - 2.0f * c, 0.0f, n1 + n6 - 2.0f * c};
  return peak;
}

// What aligning needs of a template besides t': its gradients with what the normalization cancels
// taken out, G' = w (G - mean(G) - n mean(n G)), n the normalized template; H = sum G' G^T.
typedef struct {
  float gx[TEMPLATE_SIZE], gy[TEMPLATE_SIZE];
  float hxx, hxy, hyy;
} Aligner;

inline void prepare_aligner(const float* t, Aligner* a) {
  // n, with one more sample on each side, continued linearly.
  const int pitch = TEMPLATE_PITCH + LANES;
  float n[(T + 2) * (TEMPLATE_PITCH + LANES)];
  for (int v = 0; v < T; ++v) {
    float* row = n + (v + 1) * pitch + 1;
    VSTORE((floatv)(0), row + pitch - 1 - LANES);
    for (int c = 0; c < TEMPLATE_PITCH; c += LANES) {
      const floatv w = kWeights[v] * VLOAD(kWeights + c);
      VSTORE(select((floatv)(0), VLOAD(t + v * TEMPLATE_PITCH + c) / w, w > 0.0f), row + c);
    }
    row[-1] = 2.0f * row[0] - row[1];
    row[T] = 2.0f * row[T - 1] - row[T - 2];
  }
  for (int i = 0; i < pitch; i += LANES) {
    VSTORE(2.0f * VLOAD(n + pitch + i) - VLOAD(n + 2 * pitch + i), n + i);
    VSTORE(2.0f * VLOAD(n + T * pitch + i) - VLOAD(n + (T - 1) * pitch + i),
           n + (T + 1) * pitch + i);
  }
  floatv sx = 0, sy = 0, nx = 0, ny = 0;
  for (int v = 0; v < T; ++v)
    for (int u = 0; u < TEMPLATE_PITCH; u += LANES) {
      const float* p = n + (v + 1) * pitch + 1 + u;
      const floatv w = kWeights[v] * VLOAD(kWeights + u);
      const floatv gx = 0.5f * (VLOAD(p + 1) - VLOAD(p - 1));
      const floatv gy = 0.5f * (VLOAD(p + pitch) - VLOAD(p - pitch));
      sx += w * gx;
      sy += w * gy;
      nx += w * gx * VLOAD(p);
      ny += w * gy * VLOAD(p);
    }
  const float mean_x = SUM_LANES(sx), mean_y = SUM_LANES(sy);
  const float along_x = SUM_LANES(nx), along_y = SUM_LANES(ny);
  floatv hxx = 0, hxy = 0, hyy = 0;
  for (int v = 0; v < T; ++v)
    for (int u = 0; u < TEMPLATE_PITCH; u += LANES) {
      const float* p = n + (v + 1) * pitch + 1 + u;
      const floatv w = kWeights[v] * VLOAD(kWeights + u);
      const floatv gx = 0.5f * (VLOAD(p + 1) - VLOAD(p - 1)) - mean_x - along_x * VLOAD(p);
      const floatv gy = 0.5f * (VLOAD(p + pitch) - VLOAD(p - pitch)) - mean_y - along_y * VLOAD(p);
      hxx += w * gx * gx;
      hxy += w * gx * gy;
      hyy += w * gy * gy;
      VSTORE(w * gx, a->gx + v * TEMPLATE_PITCH + u);
      VSTORE(w * gy, a->gy + v * TEMPLATE_PITCH + u);
    }
  a->hxx = SUM_LANES(hxx);
  a->hxy = SUM_LANES(hxy);
  a->hyy = SUM_LANES(hyy);
}

inline floatv along_row(__global const uchar* p, float4 c) {
  return c.x * TO_FLOAT(VLOAD(p)) + c.y * TO_FLOAT(VLOAD(p + 1)) + c.z * TO_FLOAT(VLOAD(p + 2)) +
         c.w * TO_FLOAT(VLOAD(p + 3));
}

// Gauss-Newton ascent of C over the place of the template in the target, read bicubically; inverse
// compositional (Baker and Matthews, "Lucas-Kanade 20 years on", 2004) with the gain and offset of C.
// Starts at *peak, whose maximum on the grid is (x, y) with the score `raw`; leaves *peak as it is
// unless it converges within a pixel of (x, y).
inline void align(__global const uchar* target, int width, int height, const float* t,
                  const Aligner* a, int iterations, int x, int y, float raw, Peak* peak) {
  const float det = a->hxx * a->hyy - a->hxy * a->hxy;
  if (!(det > 1e-6f * (a->hxx + a->hyy) * (a->hxx + a->hyy))) return;
  float dx = peak->x, dy = peak->y;  // from (x, y)
  for (int k = 0; k < iterations; ++k) {
    if (!(fabs(dx) <= 1.5f && fabs(dy) <= 1.5f)) return;
    const int x0 = x + (int)floor(dx) - HALF_T - 1, y0 = y + (int)floor(dy) - HALF_T - 1;
    if (x0 < 0 || y0 < 0 || x0 + T + 2 >= width || y0 + T + 2 >= height) return;
    const float4 cx = cubic_weights(dx - floor(dx)), cy = cubic_weights(dy - floor(dy));
    const float origin = target[(y0 + HALF_T) * width + x0 + HALF_T];
    floatv sum = 0, squares = 0, product = 0, ex = 0, ey = 0;
    for (int u = 0; u < TEMPLATE_PITCH; u += LANES) {
      __global const uchar* p = target + y0 * width + x0 + u;
      const floatv column = VLOAD(kWeights + u);
      floatv r0 = along_row(p, cx) - origin, r1 = along_row(p + width, cx) - origin,
             r2 = along_row(p + 2 * width, cx) - origin;
      p += 3 * width;
      for (int v = 0; v < T; ++v, p += width) {
        const floatv r3 = along_row(p, cx) - origin;
        const floatv s = cy.x * r0 + cy.y * r1 + cy.z * r2 + cy.w * r3;
        r0 = r1;
        r1 = r2;
        r2 = r3;
        const floatv ws = kWeights[v] * column * s;
        sum += ws;
        squares += ws * s;
        product += VLOAD(t + v * TEMPLATE_PITCH + u) * s;
        ex += VLOAD(a->gx + v * TEMPLATE_PITCH + u) * s;
        ey += VLOAD(a->gy + v * TEMPLATE_PITCH + u) * s;
      }
    }
    const float mean = SUM_LANES(sum);
    const float variance = SUM_LANES(squares) - mean * mean;
    if (!(variance > 1e-3f)) return;
    const float sigma = sqrt(variance);
    const float bx = SUM_LANES(ex) / sigma, by = SUM_LANES(ey) / sigma;
    const float step_x = -(a->hyy * bx - a->hxy * by) / det;
    const float step_y = -(a->hxx * by - a->hxy * bx) / det;
    const float length = fmax(fabs(step_x), fabs(step_y));
    if (k == iterations - 1 || length < 0.002f) {
      const float score = clamp(SUM_LANES(product) / sigma, -1.0f, 1.0f);
      if (length < 0.02f && fabs(dx) <= 1.0f && fabs(dy) <= 1.0f && score >= raw - 0.01f) {
        peak->x = dx;
        peak->y = dy;
        peak->score = score;
      }
      return;
    }
    dx += step_x;
    dy += step_y;
  }
}

// Keeps the MAX_PEAKS largest values; among equals the one that came first.
inline int keep_best(float* value, int* place, int kept, float new_value, int new_place) {
  if (kept == MAX_PEAKS && !(new_value > value[MAX_PEAKS - 1])) return kept;
  int i = min(kept, MAX_PEAKS - 1);
  for (; i > 0 && new_value > value[i - 1]; --i) {
    value[i] = value[i - 1];
    place[i] = place[i - 1];
  }
  value[i] = new_value;
  place[i] = new_place;
  return min(kept + 1, MAX_PEAKS);
}

inline void extract_peaks(__global const Job* job, __global const float* scores, float quality,
                          __global const uchar* target, int target_width, int target_height,
                          const float* t, int iterations, __global Result* result) {
  const int width = job->width, height = job->height, pitch = job->pitch;
  const bool along_x = (job->flat & 1) != 0, along_y = (job->flat & 2) != 0;
  floatv best_lanes = NO_SCORE;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; x += LANES)
      best_lanes = fmax(best_lanes, VLOAD(scores + y * pitch + x));
  float lanes[LANES];
  VSTORE(best_lanes, lanes);
  float best = NO_SCORE;
  for (int i = 0; i < LANES; ++i) best = fmax(best, lanes[i]);
  clear(result);
  result->best_raw = best;

  float value[MAX_PEAKS];
  int place[MAX_PEAKS];
  int kept = 0;
  const float threshold = fmax(quality * best, -1.0f);
  if (along_x || along_y) {
    // One row or one column; a single candidate is no maximum.
    const int step = along_x ? 1 : pitch, length = along_x ? width : height;
    for (int i = 1; i < length - 1; ++i) {
      const float before = scores[(i - 1) * step], c = scores[i * step],
                  after = scores[(i + 1) * step];
      if (c >= threshold && c > before && c > after && before > NO_SCORE && after > NO_SCORE)
        kept = keep_best(value, place, kept, c, i * step);
    }
  } else {
    for (int y = 1; y < height - 1; ++y)
      for (int x0 = 1; x0 < width - 1; x0 += LANES) {
        __global const float* s = scores + y * pitch + x0;
        const floatv c = VLOAD(s);
        if (!any(c >= threshold)) continue;
        const floatv above = fmax(fmax(VLOAD(s - pitch - 1), VLOAD(s - pitch)), VLOAD(s - pitch + 1));
        const floatv below = fmax(fmax(VLOAD(s + pitch - 1), VLOAD(s + pitch)), VLOAD(s + pitch + 1));
        const floatv around = fmax(fmax(above, below), fmax(VLOAD(s - 1), VLOAD(s + 1)));
        if (!any(c >= threshold && c > around)) continue;
        for (int x = x0; x < min(x0 + LANES, width - 1); ++x) {
          __global const float* p = scores + y * pitch + x;
          bool maximum = p[0] >= threshold;
          for (int j = -1; j <= 1; ++j)
            for (int i = -1; i <= 1; ++i)
              if (i != 0 || j != 0)
                maximum = maximum && p[0] > p[j * pitch + i] && p[j * pitch + i] > NO_SCORE;
          if (maximum) kept = keep_best(value, place, kept, p[0], y * pitch + x);
        }
      }
  }

  Peak peaks[MAX_PEAKS];
  Aligner aligner;
  const bool aligns = kept > 0 && iterations > 0 && !along_x && !along_y;
  if (aligns) prepare_aligner(t, &aligner);
  for (int k = 0; k < kept; ++k) {
    __global const float* p = scores + place[k];
    Peak peak;
    if (along_x || along_y) {
      const int step = along_x ? 1 : pitch;
      peak = refine_1d(p[-step], p[0], p[step]);
      if (along_y) {
        peak.y = peak.x;
        peak.x = 0.0f;
        peak.cyy = peak.cxx;
        peak.cxx = 0.0f;
      }
    } else {
      peak = refine_2d(p, pitch);
    }
    const int x = job->x + place[k] % pitch, y = job->y + place[k] / pitch;
    if (aligns)
      align(target, target_width, target_height, t, &aligner, iterations, x, y, value[k], &peak);
    peak.x += (float)x;
    peak.y += (float)y;
    // Refinement may change the order.
    int i = k;
    for (; i > 0 && peak.score > peaks[i - 1].score; --i) peaks[i] = peaks[i - 1];
    peaks[i] = peak;
  }
  for (int k = 0; k < kept; ++k) result->peaks[k] = peaks[k];
  result->count = kept;
}

__kernel void small(__global const uchar* restrict reference, int reference_width,
                    int reference_height, __global const uchar* restrict target, int target_width,
                    int target_height, __global const Job* restrict jobs, int count,
                    __global float* scores, float quality, int iterations,
                    __global Result* restrict results) {
  const int index = get_global_id(0);
  if (index >= count) return;
  __global const Job* job = jobs + index;
  __global float* out = scores + job->scores;
  float t[TEMPLATE_SIZE];
  const float sum = make_template(reference, reference_width, reference_height, job, t);
  if (isnan(sum)) {
    clear(results + index);
    return;
  }
  for (int y = 0; y < job->height; y += TILE_ROWS)
    for (int x = 0; x < job->width; x += LANES)
      score_tile(target, target_width, t, sum, job->x + x, job->y + y, job->x + job->width,
                 min(TILE_ROWS, job->height - y), out + y * job->pitch + x, job->pitch);
  extract_peaks(job, out, quality, target, target_width, target_height, t, iterations,
                results + index);
}

__kernel void templates(__global const uchar* restrict reference, int reference_width,
                        int reference_height, __global const Job* restrict jobs, int count,
                        __global float* restrict out) {
  const int index = get_global_id(0);
  if (index >= count) return;
  float t[TEMPLATE_SIZE];
  const float sum = make_template(reference, reference_width, reference_height, jobs + index, t);
  __global float* mine = out + index * TEMPLATE_FLOATS;
  for (int i = 0; i < TEMPLATE_SIZE; ++i) mine[i] = t[i];
  mine[TEMPLATE_SIZE] = sum;
}

// A tile: (job, x, y, rows), x and y counted from the job's first candidate.
__kernel void tiles(__global const uchar* restrict target, int target_width,
                    __global const Job* restrict jobs, __global const int4* restrict list, int count,
                    __global const float* restrict stored, __global float* restrict scores) {
  const int index = get_global_id(0);
  if (index >= count) return;
  const int4 tile = list[index];
  __global const Job* job = jobs + tile.x;
  __global const float* mine = stored + tile.x * TEMPLATE_FLOATS;
  if (isnan(mine[TEMPLATE_SIZE])) return;
  float t[TEMPLATE_SIZE];
  for (int i = 0; i < TEMPLATE_SIZE; ++i) t[i] = mine[i];
  score_tile(target, target_width, t, mine[TEMPLATE_SIZE], job->x + tile.y, job->y + tile.z,
             job->x + job->width, tile.w, scores + job->scores + tile.z * job->pitch + tile.y,
             job->pitch);
}

__kernel void peaks(__global const uchar* restrict target, int target_width, int target_height,
                    __global const Job* restrict jobs, int count,
                    __global const float* restrict stored, __global const float* restrict scores,
                    float quality, int iterations, __global Result* restrict results) {
  const int index = get_global_id(0);
  if (index >= count) return;
  __global const Job* job = jobs + index;
  __global const float* mine = stored + index * TEMPLATE_FLOATS;
  if (isnan(mine[TEMPLATE_SIZE])) {
    clear(results + index);
    return;
  }
  float t[TEMPLATE_SIZE];
  for (int i = 0; i < TEMPLATE_SIZE; ++i) t[i] = mine[i];
  extract_peaks(job, scores + job->scores, quality, target, target_width, target_height, t,
                iterations, results + index);
}
