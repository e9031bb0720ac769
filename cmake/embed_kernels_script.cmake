# Run with -P: writes OUTPUT, a C++ file with one byte array per file in KERNELS and the table
# corvid::embedded_kernels() that kernels/program.h declares.
set(text "#include \"kernels/program.h\"\n\nnamespace corvid {\nnamespace {\n")
set(rows "")
foreach(kernel IN LISTS KERNELS)
  get_filename_component(name "${kernel}" NAME_WE)
  file(READ "${kernel}" hex HEX)
  file(SHA256 "${kernel}" hash)
  string(REGEX REPLACE "([0-9a-f][0-9a-f])" "0x\\1," bytes "${hex}")
  string(APPEND text "constexpr unsigned char k_${name}[] = {${bytes}0};\n")
  string(APPEND rows "      {\"${name}\", {reinterpret_cast<const char*>(k_${name}), sizeof(k_${name}) - 1}, \"${hash}\"},\n")
endforeach()
string(APPEND text "}  // namespace\n\nstd::span<const EmbeddedKernel> embedded_kernels() {\n  static const EmbeddedKernel table[] = {\n${rows}  };\n  return table;\n}\n}  // namespace corvid\n")
file(WRITE "${OUTPUT}" "${text}")
