// Preloaded into a program on the host, makes its OpenCL device say that it has vectors as wide as
// those of the guest's processor: 256 bits. Kernels are built for that width, and so the guest
// finds the ones that it needs in a cache that was filled here, which saves it minutes of
// compiling.
#define CL_TARGET_OPENCL_VERSION 120
#include <CL/cl.h>
#include <dlfcn.h>

#include <cstring>

extern "C" cl_int clGetDeviceInfo(cl_device_id device, cl_device_info name, size_t size,
                                  void* value, size_t* size_out) {
  static const auto real =
      reinterpret_cast<decltype(&clGetDeviceInfo)>(dlsym(RTLD_NEXT, "clGetDeviceInfo"));
  const cl_int status = real(device, name, size, value, size_out);
  if (name == CL_DEVICE_NATIVE_VECTOR_WIDTH_INT && status == CL_SUCCESS && value != nullptr) {
    const cl_uint ints = 8;
    std::memcpy(value, &ints, sizeof ints);
  }
  return status;
}
