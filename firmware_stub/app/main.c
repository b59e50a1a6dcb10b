#include "boards/board.h"
#include "sensor_set.h"
#include "server.h"
#include "timed_run.h"

int main(void)
{
    board_start();
    timed_run_start();
    sensor_set_start();
    server_run();
}
