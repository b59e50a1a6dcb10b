/* Every form of control flow that a line may have, and lines that nothing walks: built for the host with gcov too. */
static volatile int sink;

static int never_called(int number)
{
    sink = number;
    return number + 1;
}

static inline int clamped(int number, int most)
{
    if (number > most) {
        return most;
    }
    return number;
}

static int choose(int number)
{
    switch (number) {
    case 0:
        return 10;
    case 1:
    case 2:
        sink = 2;
        break;
    case 3:
        sink = 3;
        /* fallthrough */
    case 4:
        sink = 4;
        break;
    case 5: sink = 5; break; case 6: sink = 6; break;
    default:
        return -1;
    }
    return sink;
}

static int factorial(int number)
{
    return number < 2 ? 1
                      : number * factorial(number - 1);
}

static int sum(const int *numbers, int count)
{
    int total = 0;

    for (int index = 0; index < count; index++) {
        if (numbers[index] < 0) {
            continue;
        }
        if (numbers[index] > 100 || (numbers[index] == 50 && count > 3)) {
            break;
        }
        total += numbers[index];
    }
    for (int index = 0; index < count; index++) total ^= index;
    return total;
}

static int loops(int turns)
{
    int left = turns;
    int done = 0;

    while (left > 0) {
        left--;
        do {
            done++;
        } while (done % 3 != 0);
    }
    while (done-- > 4) ;
again:
    if (left++ < 2) {
        goto again;
    }
    return clamped(
        done,
        3
    );
}

int main(void)
{
    static const int numbers[] = {1, -2, 30, 50, 7};

    for (int number = 0; number < 7; number++) {
        if (choose(number) < 0) {
            never_called(number);
        }
    }
    sink = sum(numbers, 5) + sum(numbers, 3) + sum(numbers, 0);
    sink = factorial(5) + loops(4) + clamped(2, 1) + clamped(1, 2);
    if (sink == -12345) { never_called(1); } else { sink = 0; }
    return sink ? never_called(2) : 0;
}
