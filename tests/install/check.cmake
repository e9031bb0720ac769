# Installs the build tree BUILD below WORK, builds the README's example against nothing but that
# prefix, and runs it on a recording that the installed program makes.
# Run with -DBUILD= -DSOURCE= -DWORK= -DCXX= -DFLAGS= -P.
function(must_run what)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE status OUTPUT_VARIABLE output ERROR_VARIABLE output)
  if(NOT status EQUAL 0)
    message(FATAL_ERROR "${what} ended with ${status}:\n${output}")
  endif()
  set(output "${output}" PARENT_SCOPE)
endfunction()

file(REMOVE_RECURSE "${WORK}")
file(MAKE_DIRECTORY "${WORK}")
must_run("install" ${CMAKE_COMMAND} --install "${BUILD}" --prefix "${WORK}/prefix")

file(READ "${SOURCE}/README.md" readme)
string(FIND "${readme}" "```cpp\n" begin)
if(begin EQUAL -1)
  message(FATAL_ERROR "README.md has no C++ example")
endif()
math(EXPR begin "${begin} + 7")
string(SUBSTRING "${readme}" ${begin} -1 example)
string(FIND "${example}" "```" end)
string(SUBSTRING "${example}" 0 ${end} example)
file(WRITE "${WORK}/example.cpp" "${example}")

must_run("configure" ${CMAKE_COMMAND} -G Ninja -S "${SOURCE}/tests/install" -B "${WORK}/build"
         "-DCMAKE_PREFIX_PATH=${WORK}/prefix" "-DEXAMPLE=${WORK}/example.cpp" -DCMAKE_BUILD_TYPE=Release
         "-DCMAKE_CXX_COMPILER=${CXX}"
         # g++ 12 takes a temporary with two std::string members for uninitialized at -O3.
         "-DCMAKE_CXX_FLAGS=${FLAGS} -Wall -Wextra -Werror -Wno-maybe-uninitialized")
must_run("build" ${CMAKE_COMMAND} --build "${WORK}/build")

must_run("record" "${WORK}/prefix/bin/corvid" record
         "synthetic:width=320,height=240,duration=1,rate=20,seed=2" --out "${WORK}/recording")
must_run("example" "${WORK}/build/example" "${WORK}/recording")
string(REGEX MATCHALL "[^\n]+" poses "${output}")
list(LENGTH poses count)
message("the example wrote ${count} poses")

execute_process(COMMAND "${WORK}/build/example" "${WORK}/nothing" RESULT_VARIABLE status
                ERROR_VARIABLE said)
if(NOT status EQUAL 1 OR NOT said MATCHES "nothing")
  message(FATAL_ERROR "a missing source should end with 1 and its path, not ${status}: ${said}")
endif()
