/* What every program on an ATmega328P has: subtracted from the others. */
int main(void)
{
    for (;;)
        ;
}
