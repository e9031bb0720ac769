// From the maxima of a job's pieces to its peaks: the best of all, refined; see ncc_common.cl.
// Launch, one-dimensional: finish: x >= jobs.

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
inline Peak refine_2d(const float* s) {
  const float n0 = s[0], n1 = s[1], n2 = s[2], n3 = s[3], c = s[4], n4 = s[5], n5 = s[6], n6 = s[7],
              n7 = s[8];
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
  float n[(TH + 2) * (TEMPLATE_PITCH + LANES)];
  for (int v = 0; v < TH; ++v) {
    float* row = n + (v + 1) * pitch + 1;
    VSTORE((floatv)(0), row + pitch - 1 - LANES);
    for (int c = 0; c < TEMPLATE_PITCH; c += LANES) {
      const floatv w = kWeightsY[v] * VLOAD(kWeightsX + c);
      VSTORE(select((floatv)(0), VLOAD(t + v * TEMPLATE_PITCH + c) / w, w > 0.0f), row + c);
    }
    row[-1] = 2.0f * row[0] - row[1];
    row[TW] = 2.0f * row[TW - 1] - row[TW - 2];
  }
  for (int i = 0; i < pitch; i += LANES) {
    VSTORE(2.0f * VLOAD(n + pitch + i) - VLOAD(n + 2 * pitch + i), n + i);
    VSTORE(2.0f * VLOAD(n + TH * pitch + i) - VLOAD(n + (TH - 1) * pitch + i),
           n + (TH + 1) * pitch + i);
  }
  floatv sx = 0, sy = 0, nx = 0, ny = 0;
  for (int v = 0; v < TH; ++v)
    for (int u = 0; u < TEMPLATE_PITCH; u += LANES) {
      const float* p = n + (v + 1) * pitch + 1 + u;
      const floatv w = kWeightsY[v] * VLOAD(kWeightsX + u);
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
  for (int v = 0; v < TH; ++v)
    for (int u = 0; u < TEMPLATE_PITCH; u += LANES) {
      const float* p = n + (v + 1) * pitch + 1 + u;
      const floatv w = kWeightsY[v] * VLOAD(kWeightsX + u);
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

inline floatv along_row(__global const PIXEL* p, float4 c) {
  return c.x * TO_FLOAT(VLOAD(p)) + c.y * TO_FLOAT(VLOAD(p + 1)) + c.z * TO_FLOAT(VLOAD(p + 2)) +
         c.w * TO_FLOAT(VLOAD(p + 3));
}

// Gauss-Newton ascent of C over the place of the template in the target, read bicubically; inverse
// compositional (Baker and Matthews, "Lucas-Kanade 20 years on", 2004) with the gain and offset of C.
// Starts at *peak, whose maximum on the grid is (x, y) with the score `raw`; leaves *peak as it is
// unless it converges within a pixel of (x, y).
inline void align(__global const PIXEL* target, int width, int height, const float* t,
                  const Aligner* a, int iterations, int x, int y, float raw, Peak* peak) {
  const float det = a->hxx * a->hyy - a->hxy * a->hxy;
  if (!(det > 1e-6f * (a->hxx + a->hyy) * (a->hxx + a->hyy))) return;
  float dx = peak->x, dy = peak->y;  // from (x, y)
  for (int k = 0; k < iterations; ++k) {
    if (!(fabs(dx) <= 1.5f && fabs(dy) <= 1.5f)) return;
    const int x0 = x + (int)floor(dx) - HALF_W - 1, y0 = y + (int)floor(dy) - HALF_H - 1;
    if (x0 < 0 || y0 < 0 || x0 + TW + 2 >= width || y0 + TH + 2 >= height) return;
    const float4 cx = cubic_weights(dx - floor(dx)), cy = cubic_weights(dy - floor(dy));
    const float origin = target[(size_t)(y0 + HALF_H) * width + x0 + HALF_W];
    floatv sum = 0, squares = 0, product = 0, ex = 0, ey = 0;
    for (int u = 0; u < TEMPLATE_PITCH; u += LANES) {
      __global const PIXEL* p = target + (size_t)y0 * width + x0 + u;
      const floatv column = VLOAD(kWeightsX + u);
      floatv r0 = along_row(p, cx) - origin, r1 = along_row(p + width, cx) - origin,
             r2 = along_row(p + 2 * width, cx) - origin;
      p += 3 * width;
      for (int v = 0; v < TH; ++v, p += width) {
        const floatv r3 = along_row(p, cx) - origin;
        floatv s = cy.x * r0 + cy.y * r1 + cy.z * r2 + cy.w * r3;
#ifdef FLOAT_IMAGE
        s = select((floatv)(0), s, column > 0.0f);  // no NAN from beside the footprint
#endif
        r0 = r1;
        r1 = r2;
        r2 = r3;
        const floatv ws = kWeightsY[v] * column * s;
        sum += ws;
        squares += ws * s;
        product += VLOAD(t + v * TEMPLATE_PITCH + u) * s;
        ex += VLOAD(a->gx + v * TEMPLATE_PITCH + u) * s;
        ey += VLOAD(a->gy + v * TEMPLATE_PITCH + u) * s;
      }
    }
    const float mean = SUM_LANES(sum);
    const float variance = SUM_LANES(squares) - mean * mean;
#ifdef FLOAT_IMAGE
    if (!(variance > 1e-30f)) return;
#else
    if (!(variance > 1e-3f)) return;
#endif
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

__kernel void finish(__global const PIXEL* restrict target, int target_width, int target_height,
                     __global const Job* restrict jobs, int count,
                     __global const float* restrict stored, __global const Maxima* restrict maxima,
                     float quality, int iterations, __global Result* restrict results) {
  const int index = get_global_id(0);
  if (index >= count) return;
  __global const Job* job = jobs + index;
  __global const float* mine = stored + (size_t)index * STORED;
  __global Result* result = results + index;
  clear(result);
  if (isnan(mine[SUM_AT])) return;
  float best = NO_SCORE;
  for (int i = 0; i < job->pieces; ++i) best = fmax(best, maxima[job->first_piece + i].best);
  result->best_raw = best;
  const float threshold = peak_threshold(quality, best);
  float value[MAX_PEAKS];
  int place[MAX_PEAKS], source[MAX_PEAKS];
  int kept = 0;
  for (int i = 0; i < job->pieces; ++i) {
    __global const Maxima* piece = maxima + job->first_piece + i;
    for (int k = 0; k < piece->count; ++k)
      if (piece->around[k][4] >= threshold)
        kept = keep_best(value, place, source, kept, piece->around[k][4], piece->place[k],
                         MAX_PEAKS * (job->first_piece + i) + k);
  }
  if (kept == 0) return;

  const bool along_x = (job->flat & 1) != 0, along_y = (job->flat & 2) != 0;
  const bool aligns = iterations > 0 && !along_x && !along_y;
  float t[TEMPLATE_SIZE];
  Aligner aligner;
  if (aligns) {
    for (int i = 0; i < TEMPLATE_SIZE; ++i) t[i] = mine[i];
    prepare_aligner(t, &aligner);
  }
  Peak peaks[MAX_PEAKS];
  for (int k = 0; k < kept; ++k) {
    float s[9];
    for (int i = 0; i < 9; ++i)
      s[i] = maxima[source[k] / MAX_PEAKS].around[source[k] % MAX_PEAKS][i];
    Peak peak;
    if (along_x) {
      peak = refine_1d(s[3], s[4], s[5]);
    } else if (along_y) {
      peak = refine_1d(s[1], s[4], s[7]);
      peak.y = peak.x;
      peak.x = 0.0f;
      peak.cyy = peak.cxx;
      peak.cxx = 0.0f;
    } else {
      peak = refine_2d(s);
    }
    const int x = job->x + place[k] % job->width, y = job->y + place[k] / job->width;
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
