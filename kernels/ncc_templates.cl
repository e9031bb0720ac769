// Templates; see ncc_common.cl.
// Launch, one-dimensional: templates: x >= jobs.

#define MIN_TEMPLATE_VARIANCE 0.01f  // grey^2, of 8-bit images

// Four pixels of a row from x on; pixels are repeated past the border.
#ifdef FLOAT_IMAGE
inline float4 read4(__global const float* image, int width, int height, int x, int y) {
  __global const float* row = image + (size_t)clamp(y, 0, height - 1) * width;
  if (x >= 0 && x + 3 < width) return vload4(0, row + x);
  const int last = width - 1;
  return (float4)(row[clamp(x, 0, last)], row[clamp(x + 1, 0, last)], row[clamp(x + 2, 0, last)],
                  row[clamp(x + 3, 0, last)]);
}
#else
inline uint read4(__global const uchar* image, int width, int height, int x, int y) {
  __global const uchar* row = image + (size_t)clamp(y, 0, height - 1) * width;
  if (x >= 0 && x + 3 < width) return as_uint(vload4(0, row + x));
  const int last = width - 1;
  return as_uint((uchar4)(row[clamp(x, 0, last)], row[clamp(x + 1, 0, last)],
                          row[clamp(x + 2, 0, last)], row[clamp(x + 3, 0, last)]));
}
#endif

// LANES bicubic samples of the reference at (px, py), relative to the job's whole pixel.
inline floatv sample(__global const PIXEL* reference, int width, int height,
                     __global const Job* job, floatv px, floatv py) {
  const floatv whole_x = floor(px), whole_y = floor(py);
  const floatv fx = px - whole_x, fy = py - whole_y;
  int left[LANES], top[LANES];
  VSTORE(TO_INT(whole_x) + (job->reference_x - 1), left);
  VSTORE(TO_INT(whole_y) + (job->reference_y - 1), top);
  const floatv cx[4] = {CUBIC0(fx), CUBIC1(fx), CUBIC2(fx), CUBIC3(fx)};
  const floatv cy[4] = {CUBIC0(fy), CUBIC1(fy), CUBIC2(fy), CUBIC3(fy)};
  floatv value = 0;
#pragma unroll
  for (int j = 0; j < 4; ++j) {
    floatv along = 0;
#ifdef FLOAT_IMAGE
    float columns[4][LANES];
    for (int k = 0; k < LANES; ++k) {
      const float4 four = read4(reference, width, height, left[k], top[k] + j);
      columns[0][k] = four.x;
      columns[1][k] = four.y;
      columns[2][k] = four.z;
      columns[3][k] = four.w;
    }
    for (int i = 0; i < 4; ++i) along += cx[i] * VLOAD(columns[i]);
#else
    uint words[LANES];
    for (int k = 0; k < LANES; ++k)
      words[k] = read4(reference, width, height, left[k], top[k] + j);
    const uintv word = VLOAD(words);
#pragma unroll
    for (uint i = 0; i < 4; ++i) along += cx[i] * TO_FLOAT((word >> (8 * i)) & 255U);
#endif
    value += cy[j] * along;
  }
  return value;
}

// t' of a job. Returns its sum, or NAN if there is no variance.
inline float make_template(__global const PIXEL* reference, int width, int height,
                           __global const Job* job, float* t) {
  const float a00 = job->warp[0], a01 = job->warp[1], a10 = job->warp[2], a11 = job->warp[3];
  floatv sums = 0;
  for (int v = 0; v < TH; ++v)
    for (int c = 0; c < TEMPLATE_PITCH; c += LANES) {
      // Lanes past the template repeat its last sample, with weight 0.
      const floatv du = TO_FLOAT(min(LANE_INDEX + (c - HALF_W), (intv)(HALF_W)));
      const float dv = (float)(v - HALF_H);
      const floatv value = sample(reference, width, height, job,
                                  job->fraction_x + a00 * du + a01 * dv,
                                  job->fraction_y + a10 * du + a11 * dv);
      sums += kWeightsY[v] * VLOAD(kWeightsX + c) * value;
      VSTORE(value, t + v * TEMPLATE_PITCH + c);
    }
  const float mean = SUM_LANES(sums);
  floatv variances = 0;
  for (int v = 0; v < TH; ++v)
    for (int c = 0; c < TEMPLATE_PITCH; c += LANES) {
      const floatv d = VLOAD(t + v * TEMPLATE_PITCH + c) - mean;
      const floatv wd = kWeightsY[v] * VLOAD(kWeightsX + c) * d;
      variances += wd * d;
      VSTORE(wd, t + v * TEMPLATE_PITCH + c);
    }
  const float variance = SUM_LANES(variances);
#ifdef FLOAT_IMAGE
  if (!(variance > fmax(MIN_RELATIVE_VARIANCE * mean * mean, MIN_VARIANCE) && isfinite(variance)))
    return NAN;
#else
  if (!(variance >= MIN_TEMPLATE_VARIANCE)) return NAN;
#endif
  const float scale = 1.0f / sqrt(variance);
  sums = 0;
  for (int i = 0; i < TEMPLATE_SIZE; i += LANES) {
    const floatv scaled = scale * VLOAD(t + i);
    sums += scaled;
    VSTORE(scaled, t + i);
  }
#ifdef CORVID_PLANT_FAULT
  t[HALF_H * TEMPLATE_PITCH + HALF_W + 1] = 0.0f;
#endif
  return SUM_LANES(sums);
}

__kernel void templates(__global const PIXEL* restrict reference, int reference_width,
                        int reference_height, __global const Job* restrict jobs, int count,
                        __global float* restrict out) {
  const int index = get_global_id(0);
  if (index >= count) return;
  __global float* mine = out + (size_t)index * STORED;
  float t[TEMPLATE_SIZE];
  const float sum = make_template(reference, reference_width, reference_height, jobs + index, t);
  mine[SUM_AT] = sum;
  mine[FACTOR_AT] = 1.0f;
  if (isnan(sum)) return;
  for (int i = 0; i < TEMPLATE_SIZE; i += LANES) VSTORE(VLOAD(t + i), mine + i);
#ifdef INTEGER
  // As fine as 16 bits, and 32 bits for the sum of 255 |tap|, allow.
  floatv largest_lanes = 0, total_lanes = 0;
  for (int i = 0; i < TEMPLATE_SIZE; i += LANES) {
    const floatv size = fabs(VLOAD(t + i));
    largest_lanes = fmax(largest_lanes, size);
    total_lanes += size;
  }
  float largest = 0.0f, lanes[LANES];
  VSTORE(largest_lanes, lanes);
  for (int i = 0; i < LANES; ++i) largest = fmax(largest, lanes[i]);
  const float scale = fmin(32766.0f / largest, 8.0e6f / SUM_LANES(total_lanes));
  int tap_sum = 0;
  __global int* taps = (__global int*)(mine + TAPS_AT);
  for (int v = 0; v < TH; ++v) {
    int row[2 * PAIRS_X + LANES];
    for (int c = 0; c < TEMPLATE_PITCH; c += LANES)
      VSTORE(TO_INT(rint(scale * VLOAD(t + v * TEMPLATE_PITCH + c))), row + c);
    if (TW == TEMPLATE_PITCH) row[TW] = 0;
    for (int u = 0; u < PAIRS_X; ++u) {
      tap_sum += row[2 * u] + row[2 * u + 1];
      taps[v * PAIRS_X + u] = (row[2 * u] & 0xffff) | (row[2 * u + 1] << 16);
    }
  }
  mine[SUM_AT] = (float)tap_sum;
  mine[FACTOR_AT] = 1.0f / scale;
#else
  for (int v = 0; v < TH; ++v)
    for (int u = 0; u < TW; ++u) mine[TAPS_AT + v * TW + u] = t[v * TEMPLATE_PITCH + u];
#endif
}
