#include "apps/program.h"

int main(int argc, char** argv) { return corvid::run_program(argc, argv); }
