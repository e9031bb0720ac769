# Compiler settings for every target, the third-party packages, and the helpers that make a room or a test.

set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_EXPORT_COMPILE_COMMANDS ON)

find_program(CORVID_CCACHE ccache)
if(CORVID_CCACHE AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  set(CMAKE_CXX_COMPILER_LAUNCHER "${CORVID_CCACHE}")
endif()

# Ceres and OpenCV translation units take up to about 2 GB each: cap parallel compile jobs by memory.
cmake_host_system_information(RESULT CORVID_MEMORY_MB QUERY TOTAL_PHYSICAL_MEMORY)
cmake_host_system_information(RESULT CORVID_CORES QUERY NUMBER_OF_LOGICAL_CORES)
math(EXPR CORVID_COMPILE_JOBS "${CORVID_MEMORY_MB} / 2048")
if(CORVID_COMPILE_JOBS GREATER CORVID_CORES)
  set(CORVID_COMPILE_JOBS ${CORVID_CORES})
endif()
if(CORVID_COMPILE_JOBS LESS 1)
  set(CORVID_COMPILE_JOBS 1)
endif()
set_property(GLOBAL APPEND PROPERTY JOB_POOLS corvid_compile=${CORVID_COMPILE_JOBS} corvid_link=1)
set(CMAKE_JOB_POOL_COMPILE corvid_compile)
set(CMAKE_JOB_POOL_LINK corvid_link)

find_package(Threads REQUIRED)
find_package(Eigen3 3.4 REQUIRED NO_MODULE)
find_package(Ceres 2.1 REQUIRED)
find_package(OpenCV 4.6 REQUIRED COMPONENTS core imgproc imgcodecs calib3d videoio features2d)
find_package(OpenCL REQUIRED)
find_package(fmt REQUIRED)
find_package(spdlog REQUIRED)
find_package(tl-expected REQUIRED)
find_package(yaml-cpp REQUIRED)
find_package(nlohmann_json REQUIRED)
find_package(CLI11 REQUIRED)
find_package(PkgConfig REQUIRED)
find_package(nanoflann REQUIRED)
pkg_check_modules(exif REQUIRED IMPORTED_TARGET libexif)
pkg_check_modules(libcamera REQUIRED IMPORTED_TARGET libcamera)
pkg_check_modules(geographiclib REQUIRED IMPORTED_TARGET geographiclib)
pkg_check_modules(ffmpeg REQUIRED IMPORTED_TARGET libavformat libavcodec libavutil)
find_path(DRACO_INCLUDE_DIR draco/compression/encode.h REQUIRED)
find_library(DRACO_LIBRARY draco REQUIRED)
add_library(corvid_draco INTERFACE)
target_include_directories(corvid_draco SYSTEM INTERFACE "${DRACO_INCLUDE_DIR}")
target_link_libraries(corvid_draco INTERFACE "${DRACO_LIBRARY}")

add_library(corvid_opencv INTERFACE)
target_include_directories(corvid_opencv SYSTEM INTERFACE ${OpenCV_INCLUDE_DIRS})
target_link_libraries(corvid_opencv INTERFACE ${OpenCV_LIBS})

# What every target of ours is compiled with.
add_library(corvid_flags INTERFACE)
target_compile_options(corvid_flags INTERFACE -Wall -Wextra -Wpedantic -Wshadow -Wnon-virtual-dtor
                       -Woverloaded-virtual -Wno-psabi)
if(CORVID_WERROR)
  target_compile_options(corvid_flags INTERFACE -Werror)
endif()
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # g++ 12 reports these inside Eigen and libstdc++ when it inlines them into our code.
  target_compile_options(corvid_flags INTERFACE -Wno-maybe-uninitialized -Wno-array-bounds
                         -Wno-stringop-overflow -Wno-stringop-overread -Wno-restrict)
endif()
if(CORVID_NATIVE)
  target_compile_options(corvid_flags INTERFACE -march=native)
endif()
if(CORVID_SANITIZE)
  add_compile_options(-fsanitize=${CORVID_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all -g1)
  add_link_options(-fsanitize=${CORVID_SANITIZE})
  set(CORVID_SANITIZE_FLAGS "-fsanitize=${CORVID_SANITIZE}")
  if(CORVID_SANITIZE MATCHES "address")
    if(CORVID_NATIVE)
      # 32-byte loads of AVX would meet the 16-byte allocations below.
      message(FATAL_ERROR "the address sanitizer and CORVID_NATIVE=ON do not go together")
    endif()
    # Eigen pads its allocations under this sanitizer, but not in the packaged Ceres, which frees
    # some of ours and the other way round. glibc's and the sanitizer's malloc align to 16 bytes.
    add_compile_definitions(EIGEN_MALLOC_ALREADY_ALIGNED=1)
    string(APPEND CORVID_SANITIZE_FLAGS " -DEIGEN_MALLOC_ALREADY_ALIGNED=1")
  endif()
endif()

# corvid_room(NAME DEPENDS target...): the static library of one room, from every .cpp below its folder.
function(corvid_room name)
  cmake_parse_arguments(ROOM "" "" "DEPENDS" ${ARGN})
  file(GLOB_RECURSE sources CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/*.cpp")
  add_library(corvid_${name} STATIC ${sources})
  add_library(corvid::${name} ALIAS corvid_${name})
  set_target_properties(corvid_${name} PROPERTIES EXPORT_NAME ${name})
  target_include_directories(corvid_${name} PUBLIC
    $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/include> $<INSTALL_INTERFACE:include>
    PRIVATE ${PROJECT_SOURCE_DIR})
  target_link_libraries(corvid_${name} PUBLIC ${ROOM_DEPENDS} PRIVATE $<BUILD_INTERFACE:corvid_flags>)
endfunction()

# corvid_tests(NAME LABELS label... DEPENDS target...): one test program NAME_tests from tests/NAME/*_test.cpp.
function(corvid_tests name)
  cmake_parse_arguments(TESTS "" "TIMEOUT" "LABELS;DEPENDS" ${ARGN})
  file(GLOB sources CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/${name}/*_test.cpp"
       "${CMAKE_CURRENT_SOURCE_DIR}/${name}/*_fixture.cpp")
  if(NOT sources)
    return()
  endif()
  if(NOT TESTS_TIMEOUT)
    set(TESTS_TIMEOUT 600)
  endif()
  if(CORVID_SANITIZE)
    math(EXPR TESTS_TIMEOUT "3 * ${TESTS_TIMEOUT}")
  endif()
  add_executable(${name}_tests ${sources})
  target_include_directories(${name}_tests PRIVATE ${PROJECT_SOURCE_DIR} ${PROJECT_SOURCE_DIR}/tests)
  target_link_libraries(${name}_tests PRIVATE ${TESTS_DEPENDS} corvid_flags GTest::gtest GTest::gmock
                        GTest::gtest_main)
  target_compile_definitions(${name}_tests PRIVATE CORVID_SOURCE_DIR="${PROJECT_SOURCE_DIR}")
  # The first start after a build loads OpenCV and LLVM from a cold disk: more than the usual 5 s.
  gtest_discover_tests(${name}_tests TEST_PREFIX "${name}." DISCOVERY_MODE PRE_TEST
                       DISCOVERY_TIMEOUT 120)
  # Discovery cannot pass a list on: labels and time limit are set when ctest has read the tests.
  set(properties "${CMAKE_CURRENT_BINARY_DIR}/${name}_properties.cmake")
  file(WRITE "${properties}" "foreach(test IN LISTS ${name}_tests_TESTS)
  set_tests_properties(\"\${test}\" PROPERTIES LABELS \"${TESTS_LABELS}\" TIMEOUT ${TESTS_TIMEOUT})
endforeach()
")
  set_property(DIRECTORY APPEND PROPERTY TEST_INCLUDE_FILES "${properties}")
endfunction()
